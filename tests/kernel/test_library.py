"""The compiled tissue loads, steps, and is refused where it is not the right one."""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

from carecontact.errors import DependencyError
from carecontact.kernel import binary, library

MODEL = """
<mujoco>
  <extension><plugin plugin="carecontact.tissue"><instance name="region"/></plugin></extension>
  <worldbody><body><freejoint/><geom size=".1"/><plugin instance="region"/></body></worldbody>
</mujoco>
"""


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The kernel's folder, copied; the library of this process stays loaded."""
    folder = tmp_path / "clone" / "src" / "carecontact" / "kernel"
    shutil.copytree(binary.FOLDER, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(binary, "FOLDER", folder)
    monkeypatch.setattr(binary, "SOURCES", folder / "c")
    return folder


def test_the_library_says_what_it_was_made_of() -> None:
    assert library.load().carecontact_kernel_version().decode() == binary.mark(binary.platform_here())
    assert library.load() is library.load()


def test_a_model_that_names_the_plugin_steps() -> None:
    library.load()
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert model.nplugin == 1
    assert data.qpos[2] < 0, "it falls"


def test_the_hash_is_of_the_file_that_is_loaded() -> None:
    file = binary.library_file(binary.platform_here())
    assert library.sha256() == hashlib.sha256(file.read_bytes()).hexdigest()


def test_an_edited_source_is_told_with_the_command_that_compiles_it(elsewhere: Path) -> None:
    assert library.right_file().parent == elsewhere
    with (elsewhere / "c" / "plugin.c").open("a") as file:
        file.write("// edited\n")
    with pytest.raises(DependencyError, match=r"does not belong to the C sources beside it: .*; run `python -m pip"):
        library.right_file()


def test_in_a_clone_the_command_is_of_make(elsewhere: Path) -> None:
    clone = elsewhere.parents[2]
    (clone / "tools").mkdir()
    (clone / "tools" / "bootstrap.sh").touch()
    (elsewhere / binary.PLATFORMS[binary.platform_here()].library).unlink()
    with pytest.raises(DependencyError, match=rf"is missing: .*; run `make env` in {clone}"):
        library.sha256()


def test_a_platform_without_a_binary_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binary, "platform_here", lambda: "plan9-mips")
    with pytest.raises(DependencyError, match="not exist for the platform plan9-mips; it exists for linux-x86_64, "):
        library.right_file()


def test_another_mujoco_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco, "__version__", "4.1.0")
    with pytest.raises(DependencyError, match=r"needs MuJoCo 4\.0\.0; this is 4\.1\.0; run"):
        library.sha256()


def test_a_library_that_needs_another_mujoco_is_told_in_one_line(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = library.right_file()
    if file.suffix != ".so":
        pytest.skip("only ELF names the version of the library that it needs")
    file.write_bytes(file.read_bytes().replace(b"libmujoco.so.4.0.0", b"libmujoco.so.4.9.9"))
    with pytest.raises(DependencyError, match=r"^the compiled tissue does not load: .*libmujoco\.so\.4\.9\.9.*$"):
        library._load.__wrapped__()


def test_another_plugin_of_the_name_is_told(tmp_path: Path) -> None:
    copy = tmp_path / "copy.so"
    shutil.copy(library.right_file(), copy)
    code = (
        "import sys, mujoco\n"
        "from carecontact.kernel.library import load\n"
        "mujoco.mj_loadPluginLibrary(sys.argv[1])\n"
        "try:\n    load()\nexcept Exception as error:\n    print(type(error).__name__, error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(copy)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("DependencyError another library has registered a MuJoCo plugin named carecontact.")


def test_a_second_copy_leaves_the_first_registered(tmp_path: Path) -> None:
    library.load()
    copy = tmp_path / "copy.so"
    shutil.copy(library.right_file(), copy)
    assert not ctypes.CDLL(str(copy)).carecontact_kernel_registered()
    assert library.load().carecontact_kernel_registered()
