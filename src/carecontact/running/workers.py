"""Workers on this machine: starting them, through the server that forks them, and watching what they do."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, cast

from carecontact.errors import RecordingError
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import open_recording, read_header, write_recording
from carecontact.recording.file import no_space
from carecontact.recording.schema import FAILED, KILLED, Recording
from carecontact.running.engine import Ended, StatusPipe, TrialRequest
from carecontact.running.fork_server import PROCESS_STATUS, STATUS_FD
from carecontact.running.lost import Losses, harness_error_recording, is_policy_killed, lack_in, tail
from carecontact.running.worker import (
    FIRST_ANSWER,
    LACKING,
    NO_SPACE,
    SINGLE_THREAD,
    UNREACHED,
    UNSTORED,
    WAITING,
    WITHOUT_WINDOWS,
)
from carecontact.runs.manifest import runs_beside
from carecontact.serving.conversation import WAIT_REPORT_S, PolicySetup, readable
from carecontact.serving.process_tree import readable_descriptors

# Starts workers: each is forked from a process that has imported everything, or started as a program of its own.

# -P: the folder a user happens to stand in must not shadow a module of the trial's process.
PYTHON = (sys.executable, "-P", "-X", "faulthandler", "-m")
WORKER_COMMAND = (*PYTHON, "carecontact.running.worker")
SERVER_COMMAND = (*PYTHON, "carecontact.running.fork_server")
PATIENCE_S = 60.0
"""Longest wait for a message of the fork server, which takes a second to start [s]."""


class Process(Protocol):
    """The part of the interface of ``subprocess.Popen`` that the supervisor uses of a worker's process."""

    pid: int
    returncode: int | None

    def poll(self) -> int | None: ...
    def wait(self) -> int: ...


class ServerLostError(Exception):
    """The fork server does not answer, or is gone."""


class Launcher:
    """Starts workers, each in a process group of its own."""

    def __init__(self, command: Sequence[str] = WORKER_COMMAND, *, forks: bool = True) -> None:
        """
        Args:
            command: of a worker as a program, to which the id of its parent is added; any other than WORKER_COMMAND is
                never forked.
            forks: whether to fork, where the system can.
        """
        self.command = tuple(command)
        self._forks = forks and self.command == WORKER_COMMAND and hasattr(os, "pidfd_open")
        self._server: subprocess.Popen[bytes] | None = None
        self._line: socket.socket | None = None

    def begin(self) -> None:
        """Start the fork server, if there is to be one, so that it imports while the caller does something else."""
        if self._forks:
            with suppress(OSError):  # The first ``start`` tries again.
                self._serving()

    def start(self, request: TrialRequest, *, log: Path) -> Process:
        """``request`` with a ``told_fd``; ``log``: file for what the worker prints. Raises OSError where no process can
        be started."""
        if self._forks:
            try:
                return self._forked(request, log)
            except ServerLostError:
                # Not again in this run: whatever ails it, a program of its own says so, or is free of it.
                self._forks = False
                self.close()
        return self._program(request, log)

    def close(self) -> None:
        """End the fork server; the kernel ends what it forked."""
        if self._server is not None and self._line is not None:
            self._line.close()
            self._server.kill()
            self._server.wait()
        self._server = self._line = None

    def _program(self, request: TrialRequest, log: Path) -> subprocess.Popen[bytes]:
        assert request.told_fd is not None
        with log.open("wb") as output:
            process = subprocess.Popen(
                (*self.command, str(os.getpid())), stdin=subprocess.PIPE, stdout=output, stderr=subprocess.STDOUT,
                env=_environment(), pass_fds=(request.told_fd,), start_new_session=True,
            )  # fmt: skip
        assert process.stdin is not None
        # A worker that is dead already is found so when it is polled.
        with suppress(BrokenPipeError), process.stdin as stdin:
            stdin.write(request.model_dump_json().encode())
        return process

    def _forked(self, request: TrialRequest, log: Path) -> ForkedProcess:
        """Raises ServerLostError and OSError."""
        assert request.told_fd is not None
        server, line = self._serving()
        theirs, requests = os.pipe()
        news, reports = os.pipe()
        with open(requests, "wb", 0) as stdin:
            try:
                with log.open("wb") as output:
                    socket.send_fds(line, [b"w"], [theirs, output.fileno(), request.told_fd, reports])
            except OSError:
                os.close(news)
                raise ServerLostError from None
            finally:
                os.close(theirs)
                os.close(reports)
            process = ForkedProcess(server, news)
            own = request.model_copy(update={"told_fd": STATUS_FD})
            with suppress(BrokenPipeError):
                stdin.write(own.model_dump_json().encode())
        return process

    def _serving(self) -> tuple[subprocess.Popen[bytes], socket.socket]:
        if self._server is None or self._line is None:
            self._line, far = socket.socketpair()
            with far:
                self._server = subprocess.Popen(
                    (*SERVER_COMMAND, str(os.getpid())), stdin=far.fileno(), stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL, env=_environment(), start_new_session=True,
                )  # fmt: skip
        return self._server, self._line


class ForkedProcess:
    def __init__(self, server: subprocess.Popen[bytes], news: int) -> None:
        """``news``: descriptor to read from, which this object then owns. Raises ServerLostError, and OSError if the
        server could not fork."""
        self.returncode: int | None = None
        self._server, self._news = server, news
        pid = self._next()
        if pid is None or pid < 0:
            os.close(news)
            raise ServerLostError if pid is None else OSError(-pid, os.strerror(-pid))
        self.pid = pid

    def poll(self) -> int | None:
        if is_stopped(self._server.pid):
            self._server.kill()
        if self.returncode is None and readable_descriptors([self._news], 0.0):
            self.wait()
        return self.returncode

    def wait(self) -> int:
        if self.returncode is None:
            status = self._next()
            # Without its server, the kernel has killed it.
            self.returncode = -signal.SIGKILL if status is None else status
            os.close(self._news)
        return self.returncode

    def _next(self) -> int | None:
        """Return the next number; None if the server is gone, or silent for so long that it has to go."""
        if not readable_descriptors([self._news], PATIENCE_S):
            self._server.kill()
        piece = os.read(self._news, PROCESS_STATUS.size)
        return PROCESS_STATUS.unpack(piece)[0] if piece else None


def is_stopped(pid: int) -> bool:
    """Whether somebody sent the process SIGSTOP, where the system says so: nothing in the harness does."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0] == "T"
    return False


def _environment() -> dict[str, str]:
    return {**WITHOUT_WINDOWS, **os.environ, **SINGLE_THREAD, "PYTHONHASHSEED": "0"}


# Starts the processes of trials, watches them, reaps them, and collects their recordings.

ROOM_BYTES = 48 << 20
"""Free space that a trial needs to begin: a whole trial takes 2 MB, and its policy's notes may take 32 MB more
(MAX_NOTES_BYTES of ``episode.log``)."""


@dataclass(frozen=True, kw_only=True)
class _Worker:
    spec: TrialSpec
    process: Process
    partial: Path
    output: Path
    told: StatusPipe
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
                spec=spec,
                process=process,
                partial=partial,
                output=output,
                told=StatusPipe(pipe),
                started=time.monotonic(),
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
