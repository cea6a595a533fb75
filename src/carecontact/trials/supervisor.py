"""Many trials on one machine, each in a process of its own, so that a crash costs one trial."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import read_recording, write_recording
from carecontact.recording.schema import EndReason, Recording
from carecontact.trials.failed import harness_error_recording, tail
from carecontact.trials.manifest import FAILED, survey, write_manifest
from carecontact.trials.worker import SINGLE_THREAD

# -P: the folder a user happens to stand in must not shadow a module of the trial's process.
WORKER_COMMAND = (sys.executable, "-P", "-X", "faulthandler", "-m", "carecontact.trials.worker")
POLL_S = 0.05
DEFAULT_TRIAL_LIMIT_S = 3600.0
"""Wall clock. Only a harness that hangs gets near it: a policy's own calls have deadlines in the protocol."""


@dataclass(frozen=True, kw_only=True)
class TrialEvent:
    kind: Literal["kept", "redo", "started", "finished"]
    trial_id: str
    done: int
    """Trials that need no more work, this one included."""
    total: int
    ended: EndReason | None = None
    message: str | None = None
    """First line of the failure, or why a file is run again."""


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    ended: dict[str, EndReason]
    """Every planned trial."""
    ran: tuple[str, ...]
    kept: tuple[str, ...]
    wall_s: float


@dataclass(frozen=True, kw_only=True)
class _Running:
    spec: TrialSpec
    process: subprocess.Popen[bytes]
    partial: Path
    output: Path
    started: float


@dataclass(kw_only=True)
class _Run:
    out: Path
    work: Path
    command: Sequence[str]
    environment: Mapping[str, str]
    trial_limit_s: float
    running: list[_Running] = field(default_factory=list)

    def start(self, spec: TrialSpec) -> None:
        spec_file = self.work / f"{spec.trial_id}.json"
        spec_file.write_text(spec.model_dump_json())
        partial, output = self.work / f"{spec.trial_id}.h5", self.work / f"{spec.trial_id}.log"
        with output.open("wb") as log:
            process = subprocess.Popen(
                [*self.command, str(spec_file), str(partial)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **SINGLE_THREAD, "PYTHONHASHSEED": "0", **self.environment},
                start_new_session=True,
            )
        self.running.append(
            _Running(spec=spec, process=process, partial=partial, output=output, started=time.monotonic())
        )

    def finished(self) -> list[tuple[TrialSpec, Recording]]:
        """Reap the workers that have ended or run out of time; their recordings are in ``out`` afterwards."""
        done = []
        for worker in list(self.running):
            timed_out = time.monotonic() - worker.started > self.trial_limit_s
            if worker.process.poll() is None and not timed_out:
                continue
            self.running.remove(worker)
            kill_group(worker.process)
            done.append((worker.spec, self._collect(worker, timed_out=timed_out)))
        return done

    def _collect(self, worker: _Running, *, timed_out: bool) -> Recording:
        trial_id = worker.spec.trial_id
        problem = None
        try:
            # A complete file counts even if the interpreter then crashed, as graphics drivers do while it shuts down.
            recording = read_recording(worker.partial)
            if recording.header.spec != worker.spec:
                problem = RecordingError(f"the worker recorded another trial, {recording.header.spec.trial_id}")
        except RecordingError as error:
            recording, problem = None, error
        if recording is None or problem is not None:
            output = worker.output.read_text(errors="replace")
            kind, told = _death(worker.process.returncode, timed_out=timed_out, limit_s=self.trial_limit_s)
            message = told if kind != "no_recording" else f"{told}: {problem}"
            recording = harness_error_recording(
                worker.spec, kind=kind, message=f"{message}\n\n{tail(output) or '(no output)'}"
            )
            write_recording(recording, worker.partial)
        os.replace(worker.partial, self.out / f"{trial_id}.h5")
        log = self.out / f"{trial_id}.log"
        if recording.header.ended in FAILED:
            os.replace(worker.output, log)
        else:
            log.unlink(missing_ok=True)
        return recording

    def kill_all(self) -> None:
        for worker in self.running:
            kill_group(worker.process)
        self.running.clear()


def run_trials(
    specs: Sequence[TrialSpec],
    *,
    out: Path,
    jobs: int | None = None,
    retry_failed: bool = False,
    trial_limit_s: float = DEFAULT_TRIAL_LIMIT_S,
    environment: Mapping[str, str] | None = None,
    on_event: Callable[[TrialEvent], None] = lambda event: None,
    worker_command: Sequence[str] = WORKER_COMMAND,
) -> RunSummary:
    """Run what is missing in ``out``, ``jobs`` trials at once; every trial has a recording afterwards.

    A worker that dies without a recording gets one that says how it died. On KeyboardInterrupt the workers are killed
    and finished trials stay. Raises ConfigError for a folder that holds another run.
    """
    began = time.monotonic()
    jobs = available_cores() if jobs is None else jobs
    if jobs < 1:
        raise ConfigError(f"--jobs {jobs}: must be at least 1")
    if not specs:
        raise ConfigError("no trial to run")
    found = survey(specs, out=out, retry_failed=retry_failed)
    out.mkdir(parents=True, exist_ok=True)
    write_manifest(specs, out=out)
    ended: dict[str, EndReason] = dict(found.keep)
    total = len(specs)
    for trial_id, how in found.keep.items():
        on_event(TrialEvent(kind="kept", trial_id=trial_id, ended=how, done=len(ended), total=total))
    for trial_id, why in found.redo.items():
        on_event(TrialEvent(kind="redo", trial_id=trial_id, message=why, done=len(ended), total=total))
    waiting = [spec for spec in specs if spec.trial_id not in found.keep]
    ran = tuple(spec.trial_id for spec in waiting)
    with tempfile.TemporaryDirectory(prefix=".running-", dir=out) as work:
        run = _Run(
            out=out,
            work=Path(work),
            command=worker_command,
            environment=environment or {},
            trial_limit_s=trial_limit_s,
        )
        try:
            while waiting or run.running:
                while waiting and len(run.running) < jobs:
                    spec = waiting.pop(0)
                    run.start(spec)
                    on_event(TrialEvent(kind="started", trial_id=spec.trial_id, done=len(ended), total=total))
                for spec, recording in run.finished():
                    header = recording.header
                    ended[spec.trial_id] = header.ended
                    on_event(
                        TrialEvent(
                            kind="finished",
                            trial_id=spec.trial_id,
                            ended=header.ended,
                            message=header.failure.message.partition("\n")[0] if header.failure else None,
                            done=len(ended),
                            total=total,
                        )
                    )
                if run.running:
                    time.sleep(POLL_S)
        finally:
            run.kill_all()
    return RunSummary(ended=ended, ran=ran, kept=tuple(found.keep), wall_s=time.monotonic() - began)


def available_cores() -> int:
    """Those this process may use, which inside a container are fewer than the machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """The worker and the policy process it may have left behind; both share the worker's session."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    process.wait()


def _death(returncode: int, *, timed_out: bool, limit_s: float) -> tuple[str, str]:
    if timed_out:
        return "timeout", f"the trial's process ran longer than {limit_s:g} s and was killed"
    if returncode < 0:
        return "signal", f"the trial's process died of signal {-returncode} ({signal.strsignal(-returncode)})"
    if returncode > 0:
        return "exit", f"the trial's process ended with status {returncode} and wrote no recording"
    return "no_recording", "the trial's process ended with status 0 but its recording cannot be read"
