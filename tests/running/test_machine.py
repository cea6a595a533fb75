"""What the checks of the machine conclude, and that a fault of it is one message before the first trial."""

from __future__ import annotations

import errno
import os
import re
import resource
import shutil
import subprocess
import sys
import tomllib
from collections import namedtuple
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from carecontact.cli import main
from carecontact.errors import DependencyError, StorageError
from carecontact.recording import file, read_recording
from carecontact.recording.file import replace_file
from carecontact.running import machine, supervisor
from carecontact.running.engine import TrialRequest
from carecontact.running.machine import (
    check_assets,
    check_extras,
    check_kept,
    check_opengl,
    check_packages,
    check_ready,
    check_temporary_folder,
    check_tissue,
)
from carecontact.serving.conversation import PolicySetup
from carecontact.system import CACHE_VARIABLE
from carecontact.tissue import binary, binary_lookup
from tests.running.test_supervisor import Bench, specs

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
        ["run", "--demo", "--out", "out"],
        ["sweep", "plan.toml", "--out", "out"],
        ["check", "zero-action"],
        ["view", "--start", "--task", "T1"],
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
    err = capsys.readouterr().err
    assert err.startswith("error: this machine cannot run trials: OpenGL: MUJOCO_GL=nonsense: no such OpenGL backend")
    assert err.count("\n") == 1
    assert not list(tmp_path.rglob("*.h5"))
    assert not list(tmp_path.rglob("*.json")), "a run that has not begun leaves no manifest"


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("MUJOCO_GL", "nonsense", "set it to egl or osmesa, or unset it"),
        ("MUJOCO_EGL_DEVICE_ID", "1000", "in the environment: MUJOCO_EGL_DEVICE_ID=1000"),
        ("MUJOCO_EGL_DEVICE_ID", "first", "in the environment: MUJOCO_EGL_DEVICE_ID=first"),
        ("PYOPENGL_PLATFORM", "wgl", "PYOPENGL_PLATFORM=wgl: carecontact renders with "),
        ("__EGL_VENDOR_LIBRARY_FILENAMES", "/dev/null", "in the environment: __EGL_VENDOR_LIBRARY_FILENAMES=/dev/null"),
    ],
)
def test_a_variable_that_keeps_opengl_from_rendering_is_named(
    variable: str, value: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    if variable.startswith(("MUJOCO_EGL", "__EGL")):
        monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv(variable, value)
    for frame in (False, True):
        finding = check_opengl(frame=frame)
        assert not finding.fine
        assert message in finding.detail
        assert not finding.detail.startswith("carecontact.errors"), "the message alone"
    assert check_tissue().fine, "the tissue needs no OpenGL"


@pytest.mark.usefixtures("unchecked")
def test_a_python_out_of_range_is_refused_before_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
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
    ("variables", "message"),
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
    variables: dict[str, str], message: str, monkeypatch: pytest.MonkeyPatch
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
    assert finding.detail.startswith(message)


def test_missing_package_is_named_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(machine.PACKAGES, "no-such-distribution", "no-such-distribution==1")
    finding = check_packages()
    assert not finding.fine
    assert finding.detail == "not installed: no-such-distribution"
    assert (finding.fix or "").endswith("-m pip install no-such-distribution==1")


def test_what_an_extra_would_add_is_listed_and_fails_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
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
    names = finding.detail.split(", ")
    assert {"bodies/man-adult.npz", "bodies/man-adult.skin.png", "bodies/woman-old-heavy.npz"} < set(names)
    assert names[-1] == "pose/pose_landmark_full.tflite"


def test_the_compiled_tissue_loads_and_says_what_it_is() -> None:
    finding = check_tissue()
    assert finding.fine, finding.detail
    assert finding.detail.endswith(f"sha256 {binary_lookup.binary_sha256()[:12]}; it loads")


def test_a_stale_tissue_is_named_with_the_command_that_compiles_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(binary, "FLAGS", (*binary.FLAGS, "-O2"))
    finding = check_tissue()
    assert not finding.fine
    assert "does not belong to the C sources beside it" in finding.detail
    assert finding.fix == binary_lookup.build_command()


def test_a_tissue_that_does_not_load_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "TISSUE_PROBE", "raise OSError('no such symbol')")
    finding = check_tissue()
    assert not finding.fine
    assert finding.detail.endswith("OSError: no such symbol")
    assert finding.fix == f"rm {binary_lookup.binary_file()} && {binary_lookup.build_command()}"


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


# A run that has no space: it says where and what to do, computes nothing in vain, and continues when there is some.

REMEDY = "free some space there, then give the same command again"
Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_a_file_without_space_is_named_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "results.json"
    path.write_bytes(b"earlier")

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(file.os, "fsync", full)
    with pytest.raises(StorageError) as caught:
        replace_file(path, bytes(100))
    assert str(caught.value) == f"{path}: No space left on device; {REMEDY}"
    assert [file.name for file in tmp_path.iterdir()] == ["results.json"]
    assert path.read_bytes() == b"earlier"


def test_no_trial_begins_that_cannot_be_stored(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda place: Usage(100 << 20, 99 << 20, 1 << 20))
        with pytest.raises(StorageError, match=rf"0 of 3 .* done: {bench.out}: less than 48 MB .*; {REMEDY}"):
            bench.run(specs(3))
    assert bench.ran() == []
    assert [path.name for path in bench.out.iterdir()] == ["manifest.json"]
    assert len(bench.run(specs(3)).ran) == 3


def test_a_recording_that_found_no_space_stops_the_run_and_is_made_by_the_next(bench: Bench) -> None:
    with pytest.raises(StorageError, match=rf"1 of 6 trials done: {bench.out}: No space left on device; {REMEDY}"):
        bench.run(specs(6), {"T1-s001": "full"}, jobs=1)
    assert bench.ran() == ["T1-s000", "T1-s001"]
    assert sorted(path.name for path in bench.out.iterdir()) == ["T1-s000.h5", "manifest.json"]
    summary = bench.run(specs(6))
    assert set(summary.ended.values()) == {"done"}
    assert summary.kept == ("T1-s000",)


def real_run(out: Path, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "carecontact", "run", "--policy", "zero-action", "--tasks", "T1", "--seeds", "0"]
    command += ["--protocol", "bathing-v3", "--set", "phases.time_limit_s=1", "--out", str(out), "--allow-failures"]
    return subprocess.run(command, capture_output=True, text=True, **options)


def test_a_real_run_under_a_limit_of_the_file_size(tmp_path: Path) -> None:
    """The recording of 0.3 MB does not fit."""
    out = tmp_path / "run"
    done = real_run(out, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, -1)))
    assert done.returncode == 2
    assert done.stderr == (
        f"error: the run stops with 0 of 1 trial done: {out}: No space left on device; {REMEDY} to continue\n"
    )
    assert [path.name for path in out.iterdir()] == ["manifest.json"]


def test_a_temporary_disk_without_space_is_a_fault_of_the_machine(tmp_path: Path) -> None:
    """The policy's folder cannot be made once the run has begun."""
    out, no_folder = tmp_path / "run", tmp_path / "sitecustomize.py"
    no_folder.write_text(
        "import os, sys, tempfile\n"
        "make = tempfile.mkdtemp\n"
        "def full(suffix=None, prefix=None, dir=None):\n"
        "    if prefix == 'carecontact-policy-' and 'carecontact.cli' not in sys.orig_argv:\n"
        "        raise OSError(28, 'No space left on device', '/full')\n"
        "    return make(suffix, prefix, dir)\n"
        "tempfile.mkdtemp = full\n"
    )
    done = real_run(out, env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 2, done.stderr
    assert done.stderr == (
        "error: this machine cannot run trials: temporary: no folder for a policy's process can be made and locked: "
        "[Errno 28] No space left on device: '/full'; correct this, or name another folder in the variable TMPDIR\n"
    )
    assert not out.exists() or not list(out.glob("*.h5"))


WAITS = """
import errno, os, subprocess, sys
import carecontact.recording
from carecontact.running import worker
out, whole = sys.argv[1], carecontact.recording.write_recording
remover = subprocess.Popen(["sh", "-c", f"until [ -e {out}.tried ]; do sleep 0.05; done; sleep 0.2"])
def write(recording, path):
    if os.path.exists(f"/proc/{remover.pid}"):
        open(f"{out}.tried", "w").close()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    whole(recording, path)
carecontact.recording.write_recording = write
sys.exit(worker.main(os.getppid()))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
def test_a_recording_waits_for_the_removal_of_what_the_policy_left(tmp_path: Path) -> None:
    """Else a policy that fills the disk with many files could discard a trial that it has ended."""
    spec, out = specs(1, policy="nowhere:Nothing")[0], tmp_path / "trial.h5"
    request = TrialRequest(spec=spec, policy=PolicySetup.of(spec.policy), out=out)
    command = [sys.executable, "-c", WAITS, str(out)]
    done = subprocess.run(command, input=request.model_dump_json().encode(), check=False)
    assert done.returncode == 0
    assert out.with_name("trial.h5.tried").exists()
    assert read_recording(out).header.ended == "process_failure"
