"""Starts the processes of trials, watches them, reaps them, and collects their recordings."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

from carecontact.contract.trial import TrialSpec
from carecontact.errors import RecordingError
from carecontact.hosting.conversation import WAIT_REPORT_S, readable
from carecontact.hosting.setup import PolicySetup
from carecontact.recording import open_recording, read_header, write_recording
from carecontact.recording.schema import FAILED, KILLED, Recording
from carecontact.recording.storage import no_space
from carecontact.runs.manifest import runs_beside
from carecontact.trials.engine import Ended
from carecontact.trials.failed import harness_error_recording, tail
from carecontact.trials.launch import Launcher, Process, is_stopped
from carecontact.trials.lost import Losses, is_policy_killed, lack_in
from carecontact.trials.request import TrialRequest
from carecontact.trials.told import Told
from carecontact.trials.worker import FIRST_ANSWER, LACKING, NO_SPACE, UNREACHED, UNSTORED, WAITING

ROOM_BYTES = 48 << 20
"""Free space that a trial needs to begin: a whole trial takes 2 MB, and its policy's notes may take 32 MB more
(MAX_NOTES_BYTES of ``episode.log``)."""


@dataclass(frozen=True, kw_only=True)
class _Worker:
    spec: TrialSpec
    process: Process
    partial: Path
    output: Path
    told: Told
    started: float


@dataclass(kw_only=True)
class Workers:
    """The engine ``local``: the trials of one run, each in a process of this machine."""

    out: Path
    """Folder for the recordings and logs."""
    work: Path
    """Folder for files that are not finished."""
    policy: PolicySetup
    weights: Path | None
    pace_s: float | None
    launcher: Launcher
    """The launcher; its maker closes it, because it may also start the workers of other runs."""
    trial_limit_s: float
    losses: Losses
    """Trials that this command or an earlier one lost to a signal."""
    running: list[_Worker] = field(default_factory=list[_Worker])

    def slots(self) -> int:
        return available_cores()

    def count(self) -> int:
        return len(self.running)

    def has_room(self) -> bool:
        return shutil.disk_usage(self.work).free >= ROOM_BYTES * (len(self.running) + 1)

    def start(self, spec: TrialSpec) -> None:
        # Neither a name nor a command line may show the policy, which can read both, what it is tried on.
        folder = Path(tempfile.mkdtemp(dir=self.work))
        partial, output = folder / "trial.h5", folder / "output.txt"
        pipe, told_fd = os.pipe()
        # Again for each trial: another command may have begun a run beside this one.
        closed = tuple(dict.fromkeys((*self.policy.closed, *runs_beside(self.out))))
        request = TrialRequest(
            spec=spec, policy=replace(self.policy, closed=closed), out=partial.resolve(), weights=self.weights,
            told_fd=told_fd, pace_s=self.pace_s,
        )  # fmt: skip
        try:
            process = self.launcher.start(request, log=output)
        except OSError:
            os.close(pipe)
            shutil.rmtree(folder, ignore_errors=True)
            raise
        finally:
            os.close(told_fd)
        self.running.append(
            _Worker(
                spec=spec, process=process, partial=partial, output=output, told=Told(pipe), started=time.monotonic()
            )
        )

    def finished(self) -> list[Ended]:
        """Reap the workers that have ended, were stopped or ran out of time."""
        done: list[Ended] = []
        for worker in list(self.running):
            worker.told.read()
            stopped = is_stopped(worker.process.pid)
            timed_out = time.monotonic() - worker.started > self.trial_limit_s
            if worker.process.poll() is None and not timed_out and not stopped:
                continue
            self.running.remove(worker)
            kill_tree(worker.process)
            worker.told.read()
            worker.told.close()
            if (unreached := self._unreached(worker)) is not None:
                done.append(Ended(spec=worker.spec, recording=None, unreached=unreached))
                continue
            returncode = worker.process.wait()
            if returncode == UNSTORED:
                done.append(Ended(spec=worker.spec, recording=None, unstored=self._unstored(worker)))
                continue
            if (lacked := _lacked(worker)) is not None:
                done.append(Ended(spec=worker.spec, recording=None, lacked=lacked))
                continue
            kind, death = _death(returncode, timed_out=timed_out, stopped=stopped, limit_s=self.trial_limit_s)
            recording = self._collected(worker, kind, death)
            if isinstance(recording, str):
                done.append(Ended(spec=worker.spec, recording=None, lost=recording))
                continue
            os.replace(worker.partial, self.out / f"{worker.spec.trial_id}.h5")
            self._keep_log(worker, recording)
            done.append(Ended(spec=worker.spec, recording=recording, warnings=_warnings(worker)))
        return done

    def waiting(self) -> dict[str, str]:
        lines: dict[str, str] = {}
        for worker in self.running:
            note = worker.partial.with_name(WAITING)
            with suppress(OSError):
                if time.time() - note.stat().st_mtime < 2 * WAIT_REPORT_S:
                    lines[worker.spec.trial_id] = note.read_text(errors="replace")
        return lines

    def kill_all(self) -> None:
        for worker in self.running:
            kill_tree(worker.process)
            worker.told.close()
        self.running.clear()

    def _unreached(self, worker: _Worker) -> str | None:
        # A policy of this machine could write the file to leave out a trial, but cannot choose a worker's exit status.
        believed = self.policy.ref.kind == "remote" or worker.process.wait() == LACKING
        note = worker.partial.with_name(UNREACHED)
        return note.read_text(errors="replace") if believed and note.is_file() else None

    def _unstored(self, worker: _Worker) -> str:
        with suppress(OSError):
            return readable(worker.partial.with_name(NO_SPACE).read_text(errors="replace"))
        return str(no_space(self.out, os.strerror(errno.ENOSPC)))

    def _collected(self, worker: _Worker, kind: str, death: str) -> Recording | str:
        """Return the recording, then in ``worker.partial`` whoever wrote it, or why the trial has to run once more."""
        found, problem = _read(worker)
        answers = worker.told.answers
        if kind == "no_recording":
            death += f": {problem}"
        if found is not None and (lack := lack_in(found.header)):
            lost = self.losses.died_with_policy if worker.told.policy_runs else self.losses.died
            outcome = lost(worker.spec, answers, lack, _evidence(worker), starved=True)
        elif found is not None and not is_policy_killed(found.header):
            outcome = self.losses.counted(found, answers)
        elif found is not None:
            outcome = self.losses.policy_killed(found, answers)
        elif worker.told.policy_runs:
            starved = kind == "timeout"
            outcome = self.losses.died_with_policy(worker.spec, answers, death, _evidence(worker), starved=starved)
        elif kind == KILLED:
            outcome = self.losses.died(worker.spec, answers, death, _evidence(worker))
        else:
            outcome = harness_error_recording(worker.spec, kind=kind, message=death + _evidence(worker))
        if isinstance(outcome, Recording) and outcome is not found:
            write_recording(outcome, worker.partial)
        return outcome

    def _keep_log(self, worker: _Worker, recording: Recording) -> None:
        trial_id, failure = worker.spec.trial_id, recording.header.failure
        log = self.out / f"{trial_id}.log"
        if recording.header.ended not in FAILED or failure is None:
            log.unlink(missing_ok=True)
            return
        output = worker.output.read_text(errors="replace").strip()
        head = f"{trial_id} {recording.header.ended} ({failure.kind})\n{failure.message}\n"
        printed = f"\nthe trial's process printed:\n{output}\n" if output else ""
        worker.output.write_text(head + printed, errors="replace")
        os.replace(worker.output, log)


def _read(worker: _Worker) -> tuple[Recording | None, str]:
    """Return the trial's recording, or None and what is wrong with it."""
    try:
        # A complete file counts even if the interpreter then crashed, as graphics drivers do while it shuts down.
        recording = open_recording(worker.partial)
    except RecordingError as error:
        return None, str(error)
    if recording.header.spec == worker.spec.sealed:
        return recording, ""
    return None, f"the worker recorded another trial, {recording.header.spec.trial_id}"


def _lacked(worker: _Worker) -> str | None:
    """Return why the trial could not begin to ask its policy, if it lacked a process, a thread or memory."""
    if worker.told.policy_runs or worker.told.answers:
        return None
    with suppress(RecordingError):
        return lack_in(read_header(worker.partial)) or None
    return None


def _evidence(worker: _Worker) -> str:
    return f"\n\n{tail(worker.output.read_text(errors='replace')) or '(no output)'}"


def _warnings(worker: _Worker) -> tuple[str, ...] | None:
    # A policy of this machine could write there whatever it likes.
    with suppress(OSError, ValueError):
        found: object = json.loads(worker.partial.with_name(FIRST_ANSWER).read_text())
        if isinstance(found, list):
            return tuple(readable(str(text)) for text in cast(list[object], found))
    return None


def available_cores() -> int:
    """Return the number of cores that this process may use, which inside a container are fewer than the machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def kill_tree(process: Process) -> None:
    """Kill the worker with its process group. Its policy, which has a session of its own, ends with it."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _death(returncode: int, *, timed_out: bool, stopped: bool, limit_s: float) -> tuple[str, str]:
    if stopped:
        return KILLED, "the trial's process was stopped by a signal"
    if timed_out:
        return "timeout", f"the trial's process ran longer than {limit_s:g} s and was killed"
    if returncode < 0:
        return KILLED, f"the trial's process died of signal {-returncode} ({signal.strsignal(-returncode)})"
    if returncode > 0:
        return "exit", f"the trial's process ended with status {returncode} and wrote no recording"
    return "no_recording", "the trial's process ended with status 0 but its recording cannot be read"
