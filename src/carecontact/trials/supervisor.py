"""Many trials on one machine, each in a process of its own, so that a crash costs one trial."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError, RecordingError
from carecontact.hosting.descendants import kill_marked, marks_of
from carecontact.policies.language import LANGUAGE_VARIABLE
from carecontact.recording import read_recording, write_recording
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import EndReason, Recording
from carecontact.runs.identity import POLICY_PATH, identity_of
from carecontact.runs.manifest import FAILED, Purpose, salted, survey, write_manifest
from carecontact.trials.failed import harness_error_recording, killed_by_policy_recording, tail
from carecontact.trials.worker import POLICY_RUNS, SINGLE_THREAD

# -P: the folder a user happens to stand in must not shadow a module of the trial's process.
WORKER_COMMAND = (sys.executable, "-P", "-X", "faulthandler", "-m", "carecontact.trials.worker")
WORK_PREFIX = ".running-"
LOCK = "lock"
POLL_S = 0.05
DEFAULT_TRIAL_LIMIT_S = 14400.0
"""Wall clock. Only a harness that hangs gets near it: a policy has an hour for all its calls (``BUDGET_S``), which
leaves 7 s for each of the 1,500 observations that it can ask for."""


@dataclass(frozen=True, kw_only=True)
class TrialEvent:
    kind: Literal["kept", "redo", "started", "finished"]
    trial_id: str
    done: int
    """Trials that need no more work, this one included."""
    total: int
    ended: EndReason | None = None
    message: str | None = None
    """The line of the failure that says why, or why a file is run again."""


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
    phase: int
    """End of the pipe in which the worker tells when its policy runs."""
    started: float


@dataclass(kw_only=True)
class _Run:
    out: Path
    work: Path
    command: Sequence[str]
    environment: Mapping[str, str]
    trial_limit_s: float
    running: list[_Running] = field(default_factory=list)
    again: set[str] = field(default_factory=set[str])
    """Trials whose process was lost once while their policy ran."""

    def start(self, spec: TrialSpec) -> None:
        # Neither a name nor a command line may tell the policy, which can read both, what it is tried on.
        folder = Path(tempfile.mkdtemp(dir=self.work))
        partial, output = folder / "trial.h5", folder / "output.txt"
        phase, phase_fd = os.pipe()
        os.set_blocking(phase, False)
        try:
            with output.open("wb") as log:
                process = subprocess.Popen(
                    self.command,
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, **SINGLE_THREAD, "PYTHONHASHSEED": "0", **self.environment},
                    pass_fds=(phase_fd,),
                    start_new_session=True,
                )
        finally:
            os.close(phase_fd)
        assert process.stdin is not None
        # A worker that is dead already is found so when it is polled.
        with suppress(BrokenPipeError), process.stdin as stdin:
            asked = {"spec": spec.model_dump(mode="json"), "out": str(partial.resolve()), "phase_fd": phase_fd}
            stdin.write(json.dumps(asked).encode())
        self.running.append(
            _Running(spec=spec, process=process, partial=partial, output=output, phase=phase, started=time.monotonic())
        )

    def finished(self) -> list[tuple[TrialSpec, Recording | None]]:
        """Reap the workers that have ended, were stopped or ran out of time; their recordings are then in ``out``.
        None: the trial has to run once more."""
        done: list[tuple[TrialSpec, Recording | None]] = []
        for worker in list(self.running):
            stopped = _is_stopped(worker.process)
            timed_out = time.monotonic() - worker.started > self.trial_limit_s
            if worker.process.poll() is None and not timed_out and not stopped:
                continue
            self.running.remove(worker)
            kill_tree(worker.process)
            with os.fdopen(worker.phase, "rb") as pipe:
                policy_ran = (pipe.read() or b"").endswith(POLICY_RUNS)
            recording = self._collect(worker, timed_out=timed_out, stopped=stopped, policy_ran=policy_ran)
            done.append((worker.spec, recording))
        return done

    def _collect(self, worker: _Running, *, timed_out: bool, stopped: bool, policy_ran: bool) -> Recording | None:
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
            kind, told = _death(
                worker.process.returncode, timed_out=timed_out, stopped=stopped, limit_s=self.trial_limit_s
            )
            evidence = f"\n\n{tail(output) or '(no output)'}"
            message = told if kind != "no_recording" else f"{told}: {problem}"
            if not policy_ran or timed_out:
                recording = harness_error_recording(worker.spec, kind=kind, message=f"{message}{evidence}")
            elif trial_id not in self.again:
                # Chance, such as a machine out of memory, does not come twice at the same place; a policy that kills
                # does, and must not be able to leave its bad trials out of the count.
                self.again.add(trial_id)
                return None
            else:
                recording = killed_by_policy_recording(
                    worker.spec, message=f"{message} while the policy was running, twice{evidence}"
                )
            write_recording(recording, worker.partial)
        os.replace(worker.partial, self.out / f"{trial_id}.h5")
        log = self.out / f"{trial_id}.log"
        failure = recording.header.failure
        if recording.header.ended in FAILED and failure is not None:
            output = worker.output.read_text(errors="replace").strip()
            told = f"{trial_id} {recording.header.ended} ({failure.kind})\n{failure.message}\n"
            printed = f"\nthe trial's process printed:\n{output}\n" if output else ""
            worker.output.write_text(told + printed, errors="replace")
            os.replace(worker.output, log)
        else:
            log.unlink(missing_ok=True)
        return recording

    def kill_all(self) -> None:
        for worker in self.running:
            kill_tree(worker.process)
            os.close(worker.phase)
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
    purpose: Purpose = "run",
) -> RunSummary:
    """Run what is missing in ``out``, ``jobs`` trials at once; every trial has a recording afterwards.

    A worker that dies without a recording gets one that says how it died. On KeyboardInterrupt the workers are killed
    and finished trials stay. Raises ConfigError for a folder that holds another run, that another command is writing
    to, or that cannot be written to.
    """
    began = time.monotonic()
    check_jobs(jobs)
    jobs = available_cores() if jobs is None else jobs
    if not specs:
        raise ConfigError("no trial to run")
    given = environment or {}
    identity = identity_of(
        specs[0], search_path=given.get(POLICY_PATH, "").split(os.pathsep), language=given.get(LANGUAGE_VARIABLE)
    )
    found = survey(specs, out=out, retry_failed=retry_failed, identity=identity)
    specs = salted(specs, out=out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        remove_abandoned(out)
        write_manifest(specs, out=out, identity=identity, purpose=purpose)
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be written to: {error.strerror}") from None
    ended: dict[str, EndReason] = dict(found.keep)
    total = len(specs)
    for trial_id, how in found.keep.items():
        on_event(TrialEvent(kind="kept", trial_id=trial_id, ended=how, done=len(ended), total=total))
    for trial_id, why in found.redo.items():
        on_event(TrialEvent(kind="redo", trial_id=trial_id, message=why, done=len(ended), total=total))
    waiting = [spec for spec in specs if spec.trial_id not in found.keep]
    ran = tuple(spec.trial_id for spec in waiting)
    with _work_folder(out) as work:
        run = _Run(
            out=out,
            work=work,
            command=worker_command,
            environment=given,
            trial_limit_s=trial_limit_s,
        )
        try:
            while waiting or run.running:
                while waiting and len(run.running) < jobs:
                    spec = waiting.pop(0)
                    run.start(spec)
                    on_event(TrialEvent(kind="started", trial_id=spec.trial_id, done=len(ended), total=total))
                for spec, recording in run.finished():
                    if recording is None:
                        waiting.insert(0, spec)
                        why = "its process was lost while the policy was running"
                        on_event(
                            TrialEvent(kind="redo", trial_id=spec.trial_id, message=why, done=len(ended), total=total)
                        )
                        continue
                    header = recording.header
                    ended[spec.trial_id] = header.ended
                    on_event(
                        TrialEvent(
                            kind="finished",
                            trial_id=spec.trial_id,
                            ended=header.ended,
                            message=reason_of(header.failure) if header.failure else None,
                            done=len(ended),
                            total=total,
                        )
                    )
                if run.running:
                    time.sleep(POLL_S)
        finally:
            run.kill_all()
    return RunSummary(ended=ended, ran=ran, kept=tuple(found.keep), wall_s=time.monotonic() - began)


def check_jobs(jobs: int | None) -> None:
    """Raises ConfigError for a number of workers that is none."""
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs {jobs}: must be at least 1")


def remove_abandoned(out: Path) -> None:
    """Remove what a killed supervisor left in ``out``. Raises ConfigError while a living one is at work there."""
    for folder in out.glob(f"{WORK_PREFIX}*"):
        lock = folder / LOCK
        if lock.is_file():
            with lock.open() as stream:
                try:
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise ConfigError(f"{out}: another command is running trials into it; wait for it") from None
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _work_folder(out: Path) -> Iterator[Path]:
    """Locked for as long as this process lives, however it ends."""
    with tempfile.TemporaryDirectory(prefix=WORK_PREFIX, dir=out) as folder, (Path(folder) / LOCK).open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield Path(folder)


def available_cores() -> int:
    """Those this process may use, which inside a container are fewer than the machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def kill_tree(process: subprocess.Popen[bytes]) -> None:
    """The worker with its process group, and its policy, which has a session of its own, with all that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kill_marked(marks_of(process.pid))


def _is_stopped(process: subprocess.Popen[bytes]) -> bool:
    """Whether somebody sent it SIGSTOP: nothing in the harness does."""
    try:
        return os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
    except (AttributeError, ChildProcessError):
        return False


def _death(returncode: int, *, timed_out: bool, stopped: bool, limit_s: float) -> tuple[str, str]:
    if stopped:
        return "signal", "the trial's process was stopped by a signal"
    if timed_out:
        return "timeout", f"the trial's process ran longer than {limit_s:g} s and was killed"
    if returncode < 0:
        return "signal", f"the trial's process died of signal {-returncode} ({signal.strsignal(-returncode)})"
    if returncode > 0:
        return "exit", f"the trial's process ended with status {returncode} and wrote no recording"
    return "no_recording", "the trial's process ended with status 0 but its recording cannot be read"
