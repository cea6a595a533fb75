"""A run that has no space: it says where and what to do, computes nothing in vain, and continues when there is some."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from carecontact.errors import StorageError
from carecontact.hosting.setup import PolicySetup
from carecontact.recording import read_recording, writer
from carecontact.recording.writer import replace_file
from carecontact.trials.request import TrialRequest
from tests.trials.test_supervisor import Bench, specs

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

    monkeypatch.setattr(writer.os, "fsync", full)
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


def test_a_real_run_under_a_limit_of_the_file_size(tmp_path: Path) -> None:
    """The recording of 0.3 MB does not fit; with the limit gone, the same command makes it."""
    out = tmp_path / "run"
    command = [
        sys.executable, "-m", "carecontact", "run", "--policy", "zero-action", "--tasks", "T1", "--seeds", "0",
        "--set", "phases.time_limit_s=1", "--out", str(out), "--allow-failures",
    ]  # fmt: skip

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))

    done = subprocess.run(command, preexec_fn=limited, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        f"error: the run stops with 0 of 1 trial done: {out}: No space left on device; {REMEDY} to continue\n"
    )
    assert [path.name for path in out.iterdir()] == ["manifest.json"]
    assert subprocess.run(command, capture_output=True).returncode == 0
    assert read_recording(out / "T1-s000.h5").header.ended == "time_limit"
    assert not [path for path in out.iterdir() if path.name.startswith(".")]


def test_a_temporary_disk_without_space_is_nobodys_failure(tmp_path: Path) -> None:
    """The policy's folder cannot be made once the run has begun; with another one, the same command continues."""
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
    command = [
        sys.executable, "-m", "carecontact", "run", "--policy", "zero-action", "--tasks", "T1", "--seeds", "0-1",
        "--set", "phases.time_limit_s=1", "--jobs", "1", "--out", str(out),
    ]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert done.stderr == (
        "error: this machine cannot run trials: temporary: no folder for a policy's process can be made and locked: "
        "[Errno 28] No space left on device: '/full'; correct this, or name another folder in the variable TMPDIR\n"
    )
    assert not out.exists() or not list(out.glob("*.h5"))
    assert subprocess.run(command, capture_output=True).returncode == 0


WAITS = """
import errno, os, subprocess, sys
import carecontact.recording
from carecontact.trials import worker
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
