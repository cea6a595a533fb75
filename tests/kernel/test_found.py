"""The right binary is found, and any other is refused with the command that helps."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from carecontact.errors import DependencyError
from carecontact.kernel import binary, found


def test_the_hash_is_of_the_file_that_is_loaded() -> None:
    file = binary.library_file(binary.platform_here())
    assert found.sha256() == hashlib.sha256(file.read_bytes()).hexdigest()


def test_the_hash_is_known_without_loading_mujoco_or_the_binary() -> None:
    code = (
        "import sys\nfrom carecontact.kernel import found\nassert len(found.sha256()) == 64\n"
        "assert 'mujoco' not in sys.modules\nassert found.file().name not in open('/proc/self/maps').read()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_edited_source_is_told_with_the_command_that_compiles_it(elsewhere: Path) -> None:
    assert found.file().parent == elsewhere
    with (elsewhere / "c" / "plugin.c").open("a") as file:
        file.write("// edited\n")
    with pytest.raises(DependencyError, match=r"does not belong to the C sources.* -m pip install .*CARECONTACT"):
        found.file()


def test_in_a_clone_the_command_is_of_make(elsewhere: Path) -> None:
    clone = elsewhere.parents[2]
    (clone / "tools").mkdir()
    (clone / "tools" / "bootstrap.sh").touch()
    (elsewhere / binary.PLATFORMS[binary.platform_here()].library).unlink()
    with pytest.raises(DependencyError, match=rf"is missing: .*; run `make -C {clone} env`"):
        found.sha256()


def test_a_platform_without_a_binary_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binary, "platform_here", lambda: "plan9-mips")
    with pytest.raises(DependencyError, match="not exist for the platform plan9-mips; it exists for linux-x86_64, "):
        found.file()


@pytest.mark.parametrize(("installed", "told"), [({"mujoco": "4.1.0"}, r"4\.1\.0"), ({}, "not installed")])
def test_another_mujoco_is_named(installed: dict[str, str], told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name not in installed:
            raise metadata.PackageNotFoundError(name)
        return installed[name]

    monkeypatch.setattr(found.metadata, "version", version)
    with pytest.raises(DependencyError, match=rf"needs MuJoCo 4\.0\.0, and it is {told}; run .*pip install mujoco==4"):
        found.sha256()
