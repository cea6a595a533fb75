"""Packages that a test installs, and registries that have not looked for them yet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from carecontact.registry import Registry


def look_again(patch: pytest.MonkeyPatch, *registries: Registry[Any]) -> None:
    """Let registries find what is installed now, and forget it when ``patch`` is undone."""
    for registry in registries:
        registry._load_scanned()
        for name, state in (
            ("_rows", dict(registry._rows)),
            ("_origins", dict(registry._origins)),
            ("_points", None),
            ("_faults", dict[str, str]()),
        ):
            patch.setattr(registry, name, state)


def write_package(
    site: Path, name: str, *, version: str = "1.0", files: Mapping[str, str], points: Mapping[str, Mapping[str, str]]
) -> None:
    """Write an installed package into ``site``.

    Args:
        files: module -> its source.
        points: plural of a registry, as in ``behaviours`` -> name -> what its entry point names.
    """
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = [
        "\n".join([f"[carecontact.{plural}]", *(f"{point} = {value}" for point, value in rows.items())])
        for plural, rows in points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups) + "\n")
    for module, source in files.items():
        (site / f"{module}.py").write_text(source)
