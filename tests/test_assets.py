"""Everything shipped as data: whose it is, whether we may ship it, and that it is the file that was made."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

import carecontact

FOLDER = Path(carecontact.__file__).parent / "assets"
RECORDS = ("LICENSE", ".provenance.json", ".py")
ASSETS = sorted(p for p in FOLDER.rglob("*") if p.is_file() and not p.name.endswith(RECORDS) and p.suffix != ".pyc")
FREE_LICENCES = ("Apache-2.0", "CC0", "BSD-3-Clause", "MIT")
MAX_BYTES = 3_000_000
NETWORK_MAX_BYTES = {"pose": 7_000_000, "learned": 5_000_000}
"""Largest size of a file in the folders of networks, whose weights cannot be compressed further."""


def provenance(path: Path) -> Path:
    return path.with_suffix(".provenance.json")


def record(path: Path) -> dict[str, object]:
    return json.loads(provenance(path).read_text(encoding="utf-8"))


def test_there_are_a_body_its_skin_and_a_robot() -> None:
    assert {p.suffix for p in ASSETS if p.parent.name == "bodies"} == {".npz", ".png"}
    assert [p.name for p in ASSETS if p.parent.name == "panda"] == ["panda.npz"]
    assert len([p for p in ASSETS if p.parent.name == "pose"]) == 2


@pytest.mark.parametrize("path", ASSETS, ids=lambda p: p.name)
def test_source_licence_and_script_are_beside_it(path: Path) -> None:
    written = record(path)
    assert any(licence in str(written["licence"]) for licence in FREE_LICENCES)
    assert written["source"]
    script = Path(carecontact.__file__).parents[2] / str(written["script"])
    # An installed wheel has no tools folder; a checkout has to have the script that made the file.
    assert script.is_file() or not (script.parents[1] / "pyproject.toml").exists()


@pytest.mark.parametrize("path", ASSETS, ids=lambda p: p.name)
def test_it_is_the_file_that_was_recorded(path: Path) -> None:
    assert hashlib.sha256(path.read_bytes()).hexdigest() == record(path)["sha256"]


@pytest.mark.parametrize("path", ASSETS, ids=lambda p: p.name)
def test_it_is_small(path: Path) -> None:
    assert 1_000 < path.stat().st_size < NETWORK_MAX_BYTES.get(path.parent.name, MAX_BYTES)


def test_no_provenance_without_its_file() -> None:
    assert sorted(FOLDER.rglob("*.provenance.json")) == sorted(provenance(p) for p in ASSETS)


def test_work_under_another_licence_carries_its_text() -> None:
    """The robot's meshes are the manufacturer's; their licence asks that its text travels with them."""
    text = (FOLDER / "panda" / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text
    assert "Version 2.0" in text


def test_archives_hold_no_code() -> None:
    """Object arrays would be pickles, which run code when they are read."""
    for path in ASSETS:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                assert not any(archive[name].dtype.hasobject for name in archive.files)
