"""The compiled tissue loads, steps, and is refused where it is not the right one."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

from carecontact.errors import DependencyError
from carecontact.kernel import binary, found, library
from carecontact.kernel.readings import Readings
from tests.kernel.sheets import model_xml, sheet, tissue


def test_the_library_says_what_it_was_made_of() -> None:
    assert library.load().carecontact_kernel_version().decode() == binary.mark(binary.platform_here())
    assert library.load() is library.load()


def test_a_model_that_names_the_plugin_steps() -> None:
    library.load()
    model = mujoco.MjModel.from_xml_string(model_xml(tissue(), sheet(half_m=0.02)))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert model.nplugin == 1
    assert 0.015 < data.qpos[2] < 0.02, "the ball rests in the sheet"
    assert Readings(model, "sheet").last(data, 1)["force_n"][0, 2] == pytest.approx(-0.981, rel=0.05)


def test_a_library_that_needs_another_mujoco_is_told_in_one_line(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = found.file()
    if file.suffix != ".so":
        pytest.skip("only ELF names the version of the library that it needs")
    file.write_bytes(file.read_bytes().replace(b"libmujoco.so.4.0.0", b"libmujoco.so.4.9.9"))
    with pytest.raises(DependencyError, match=r"^the compiled tissue does not load: .*libmujoco\.so\.4\.9\.9.*$"):
        library._load.__wrapped__()


def test_another_plugin_of_the_name_is_told(tmp_path: Path) -> None:
    copy = tmp_path / "copy.so"
    shutil.copy(found.file(), copy)
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
    shutil.copy(found.file(), copy)
    assert not ctypes.CDLL(str(copy)).carecontact_kernel_registered()
    assert library.load().carecontact_kernel_registered()
