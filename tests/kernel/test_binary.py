"""A binary is known to be of its sources without being loaded."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from carecontact.kernel import binary

ROOT = Path(__file__).parents[2]


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "a.c").write_text("int a;\n")
    (tmp_path / "b.h").write_text("int b;\n")
    monkeypatch.setattr(binary, "SOURCES", tmp_path)
    return tmp_path


def test_the_mark_changes_with_sources_platform_and_flags(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marks = [binary.mark("linux-x86_64"), binary.mark("linux-aarch64")]
    (sources / "b.h").write_text("int c;\n")
    marks.append(binary.mark("linux-x86_64"))
    (sources / "b.h").rename(sources / "c.h")
    marks.append(binary.mark("linux-x86_64"))
    monkeypatch.setattr(binary, "FLAGS", (*binary.FLAGS, "-O2"))
    marks.append(binary.mark("linux-x86_64"))
    assert len(set(marks)) == 5


def test_the_mark_does_not_depend_on_other_files(sources: Path) -> None:
    before = binary.mark("linux-x86_64")
    (sources / "a.o").write_bytes(b"")
    assert binary.mark("linux-x86_64") == before


def test_a_mark_is_found_among_other_bytes(tmp_path: Path) -> None:
    file = tmp_path / "library"
    file.write_bytes(b"\x7fELF\0" + binary.mark("linux-aarch64").encode() + b"\0MuJoCo")
    assert binary.mark_in(file) == binary.mark("linux-aarch64")
    file.write_bytes(b"\x7fELF")
    assert binary.mark_in(file) is None


def test_a_binary_that_is_cut_off_is_told_before_it_is_loaded(elsewhere: Path) -> None:
    """Its mark may still be there, and loading it would end the process."""
    here = binary.platform_here()
    file = binary.library_file(here)
    if file.suffix != ".so":
        pytest.skip("only ELF says where it ends")
    assert elsewhere in file.parents
    assert binary.fault(here) is None
    file.write_bytes(file.read_bytes()[:-1])
    assert binary.fault(here) == f"is cut off: {file}"


def test_the_script_runs_without_the_package_and_finds_nothing_wrong() -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-S", binary.__file__], capture_output=True, text=True, check=False, cwd="/"
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_build_requires_the_versions_that_the_mark_names() -> None:
    requires = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert {f"ziglang=={binary.ZIG}", f"mujoco-core=={binary.MUJOCO}"} <= set(requires)
    assert any(re.fullmatch(rf"mujoco=={binary.MUJOCO}", line) for line in metadata.requires("carecontact") or [])
