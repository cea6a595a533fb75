"""What the checks of the machine conclude, and that a fault of it is one message before the first trial."""

from __future__ import annotations

import errno
import os
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from carecontact.cache_folder import CACHE_VARIABLE
from carecontact.cli import main
from carecontact.errors import DependencyError
from carecontact.kernel import binary, found
from carecontact.trials import machine, supervisor
from carecontact.trials.machine import (
    check_assets,
    check_extras,
    check_kept,
    check_opengl,
    check_packages,
    check_ready,
    check_temporary_folder,
    check_tissue,
)
from tests.trials.test_supervisor import Bench, specs

ROOT = Path(__file__).parents[2]
PLAN = """
tasks = "T1"
seeds = "0"
[[policies]]
policy = "zero-action"
"""


@pytest.fixture
def unchecked() -> Iterator[None]:
    """No check of this process before the test counts in it, nor one of it after."""
    check_ready.cache_clear()
    yield
    check_ready.cache_clear()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "command",
    [
        ["run", "--policy", "zero-action", "--tasks", "T1", "--seeds", "0-1", "--out", "out"],
        ["demo", "--out", "out"],
        ["sweep", "plan.toml", "--out", "out"],
        ["check", "zero-action"],
        ["look", "--task", "T1"],
    ],
    ids=lambda command: command[0],
)
def test_a_fault_of_the_machine_is_one_message_before_the_first_trial(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan.toml").write_text(PLAN)
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    assert main(command) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: this machine cannot run trials: OpenGL: MUJOCO_GL=nonsense: no such OpenGL backend")
    assert told.count("\n") == 1
    assert not list(tmp_path.rglob("*.h5"))
    assert not list(tmp_path.rglob("*.json")), "a run that has not begun leaves no manifest"


@pytest.mark.parametrize(
    ("variable", "value", "told"),
    [
        ("MUJOCO_GL", "nonsense", "set it to egl or osmesa, or unset it"),
        ("MUJOCO_EGL_DEVICE_ID", "1000", "MUJOCO_EGL_DEVICE_ID=1000; unset or correct it"),
        ("MUJOCO_EGL_DEVICE_ID", "first", "MUJOCO_EGL_DEVICE_ID=first; unset or correct it"),
        ("PYOPENGL_PLATFORM", "wgl", "PYOPENGL_PLATFORM=wgl: carecontact renders with "),
        ("__EGL_VENDOR_LIBRARY_FILENAMES", "/dev/null", "__EGL_VENDOR_LIBRARY_FILENAMES=/dev/null; unset or correct"),
    ],
)
def test_a_variable_that_keeps_opengl_from_rendering_is_named(
    variable: str, value: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    if variable.startswith(("MUJOCO_EGL", "__EGL")):
        monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv(variable, value)
    for frame in (False, True):
        finding = check_opengl(frame=frame)
        assert not finding.fine
        assert told in finding.detail
        assert not finding.detail.startswith("carecontact.errors"), "the message alone"
    assert check_tissue().fine, "the tissue needs no OpenGL"


@pytest.mark.usefixtures("unchecked")
def test_a_python_out_of_range_is_told_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "PYTHON", ((3, 1), (3, 2)))
    with pytest.raises(DependencyError, match=r"^this machine cannot run trials: python: 3\.\d+\.\d+; needs 3\.11"):
        check_ready()


def test_a_temporary_folder_that_cannot_be_made_names_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(**_: object) -> str:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), "/scratch/carecontact-policy-1")

    monkeypatch.setattr("tempfile.mkdtemp", refused)
    finding = check_temporary_folder()
    assert not finding.fine
    assert "Read-only file system: '/scratch/carecontact-policy-1'" in finding.detail
    assert finding.detail.endswith("in the variable TMPDIR")


@pytest.mark.usefixtures("unchecked")
def test_a_check_that_gets_no_process_is_left_to_the_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **options: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr("subprocess.run", refused)
    check_ready()


@pytest.mark.usefixtures("unchecked")
def test_a_run_that_lacks_nothing_asks_nothing_of_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, asked = Bench(tmp_path), list[bool]()
    monkeypatch.setattr(supervisor, "check_ready", lambda: asked.append(True))
    bench.run(specs(2))
    assert asked == [True]
    bench.run(specs(2))
    assert asked == [True]


@pytest.mark.parametrize(
    ("variables", "told"),
    [
        ({CACHE_VARIABLE: ""}, "nothing is kept between trials, as CARECONTACT_CACHE is empty;"),
        (
            {CACHE_VARIABLE: "/proc/none"},
            "nothing is kept between trials, as /proc/none cannot be written to (No such file or directory);",
        ),
        ({}, "nothing is kept between trials, as this user has no home folder;"),
    ],
)
def test_where_nothing_can_be_kept_is_a_warning(
    variables: dict[str, str], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(user: int) -> None:
        raise KeyError(user)

    for name in (CACHE_VARIABLE, "HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    finding = check_kept()
    assert (finding.fine, finding.warning) == (True, True)
    assert finding.detail.startswith(told)


def test_missing_package_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(machine.PACKAGES, "no-such-distribution", "no-such-distribution==1")
    finding = check_packages()
    assert not finding.fine
    assert finding.detail == "not installed: no-such-distribution"
    assert (finding.fix or "").endswith("-m pip install no-such-distribution==1")


def test_what_an_extra_would_add_is_told_and_fails_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        machine, "EXTRAS", {"tables": (("no-such-distribution",), "run.trials()"), "x": (("numpy",), "y")}
    )
    finding = check_extras()
    assert finding.fine
    assert finding.detail == (
        "optional and not installed: tables (for run.trials()); pip install 'carecontact[tables]' adds the first"
    )


def test_the_extras_are_those_of_the_package() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    names = {extra: {re.split(r"[<>=]", line)[0] for line in lines} for extra, lines in declared.items()}
    assert {extra: set(packages) for extra, (packages, _) in machine.EXTRAS.items()} == names


def test_shipped_assets_match_their_provenance() -> None:
    finding = check_assets()
    assert finding.fine
    told = finding.detail.split(", ")
    assert {"bodies/man-adult.npz", "bodies/man-adult.skin.png", "bodies/woman-old-heavy.npz"} < set(told)
    assert told[-1] == "panda/panda.npz"


def test_the_compiled_tissue_loads_and_says_what_it_is() -> None:
    finding = check_tissue()
    assert finding.fine, finding.detail
    assert finding.detail.endswith(f"sha256 {found.sha256()[:12]}; it loads")


def test_a_stale_tissue_is_told_with_the_command_that_compiles_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binary, "FLAGS", (*binary.FLAGS, "-O2"))
    finding = check_tissue()
    assert not finding.fine
    assert "does not belong to the C sources beside it" in finding.detail
    assert finding.fix == found.making()


def test_a_tissue_that_does_not_load_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "TISSUE_PROBE", "raise OSError('no such symbol')")
    finding = check_tissue()
    assert not finding.fine
    assert finding.detail.endswith("OSError: no such symbol")
    assert finding.fix == f"rm {found.file()} && {found.making()}"


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("pass", None),
        ("raise SystemError('bad driver')", "SystemError: bad driver"),
        ("import os; os.abort()", "ended"),
    ],
)
def test_probe_survives_what_it_probes(code: str, expected: str | None) -> None:
    problem = machine._probe(code, environment={})
    assert problem is None if expected is None else expected in (problem or "")
