"""A binary is known to be of its sources without being loaded."""

from __future__ import annotations

import ctypes
import hashlib
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import mujoco
import pytest

from carecontact.errors import DependencyError
from carecontact.tissue import binary, binary_lookup, plugin
from carecontact.tissue.plugin import Readings
from tests.tissue.sheets import model_xml, sheet, tissue

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


def test_a_binary_that_is_cut_off_is_reported_before_it_is_loaded(elsewhere: Path) -> None:
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


# The right binary is found, and any other is refused with the command that helps.


def test_the_hash_is_of_the_file_that_is_loaded() -> None:
    file = binary.library_file(binary.platform_here())
    assert binary_lookup.binary_sha256() == hashlib.sha256(file.read_bytes()).hexdigest()


def test_the_hash_is_known_without_loading_mujoco_or_the_binary() -> None:
    code = (
        "import sys\nfrom carecontact.tissue.binary_lookup import binary_file, binary_sha256\n"
        "assert len(binary_sha256()) == 64\nassert 'mujoco' not in sys.modules\n"
        "assert binary_file().name not in open('/proc/self/maps').read()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_edited_source_is_reported_with_the_command_that_compiles_it(elsewhere: Path) -> None:
    assert binary_lookup.binary_file().parent == elsewhere
    with (elsewhere / "c" / "plugin.c").open("a") as file:
        file.write("// edited\n")
    with pytest.raises(DependencyError, match=r"does not belong to the C sources.* -m pip install .*CARECONTACT"):
        binary_lookup.binary_file()


def test_in_a_clone_the_command_is_of_make(elsewhere: Path) -> None:
    clone = elsewhere.parents[2]
    (clone / "tools").mkdir()
    (clone / "tools" / "bootstrap.sh").touch()
    (elsewhere / binary.PLATFORMS[binary.platform_here()].library).unlink()
    with pytest.raises(DependencyError, match=rf"is missing: .*; run `make -C {clone} env`"):
        binary_lookup.binary_sha256()


def test_a_platform_without_a_binary_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binary, "platform_here", lambda: "plan9-mips")
    with pytest.raises(DependencyError, match="not exist for the platform plan9-mips; it exists for linux-x86_64, "):
        binary_lookup.binary_file()


@pytest.mark.parametrize(("installed", "message"), [({"mujoco": "4.1.0"}, r"4\.1\.0"), ({}, "not installed")])
def test_another_mujoco_is_named(installed: dict[str, str], message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name not in installed:
            raise metadata.PackageNotFoundError(name)
        return installed[name]

    monkeypatch.setattr(binary_lookup.metadata, "version", version)
    with pytest.raises(
        DependencyError, match=rf"needs MuJoCo 4\.0\.0, and it is {message}; run .*pip install mujoco==4"
    ):
        binary_lookup.binary_sha256()


# The compiled tissue loads, steps, and is refused where it is not the right one.


def test_the_library_says_what_it_was_made_of() -> None:
    assert plugin.load_plugins().carecontact_kernel_version().decode() == binary.mark(binary.platform_here())
    assert plugin.load_plugins() is plugin.load_plugins()


def test_a_model_that_names_the_plugin_steps() -> None:
    plugin.load_plugins()
    model = mujoco.MjModel.from_xml_string(model_xml(tissue(), sheet(half_m=0.02)))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert model.nplugin == 1
    assert 0.015 < data.qpos[2] < 0.02, "the ball rests in the sheet"
    assert Readings(model, "sheet").last(data, 1)["force_n"][0, 2] == pytest.approx(-0.981, rel=0.05)


def test_a_library_that_needs_another_mujoco_is_reported_in_one_line(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = binary_lookup.binary_file()
    if file.suffix != ".so":
        pytest.skip("only ELF names the version of the library that it needs")
    file.write_bytes(file.read_bytes().replace(b"libmujoco.so.4.0.0", b"libmujoco.so.4.9.9"))
    with pytest.raises(DependencyError, match=r"^the compiled tissue does not load: .*libmujoco\.so\.4\.9\.9.*$"):
        plugin._load.__wrapped__()


def test_another_plugin_of_the_name_is_reported(tmp_path: Path) -> None:
    copy = tmp_path / "copy.so"
    shutil.copy(binary_lookup.binary_file(), copy)
    code = (
        "import sys, mujoco\n"
        "from carecontact.tissue.plugin import load_plugins as load\n"
        "mujoco.mj_loadPluginLibrary(sys.argv[1])\n"
        "try:\n    load()\nexcept Exception as error:\n    print(type(error).__name__, error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(copy)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("DependencyError another library has registered a MuJoCo plugin named carecontact.")


def test_a_second_copy_leaves_the_first_registered(tmp_path: Path) -> None:
    plugin.load_plugins()
    copy = tmp_path / "copy.so"
    shutil.copy(binary_lookup.binary_file(), copy)
    assert not ctypes.CDLL(str(copy)).carecontact_kernel_registered()
    assert plugin.load_plugins().carecontact_kernel_registered()
