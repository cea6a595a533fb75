"""Workers on this machine: starting them, through the server that forks them, and watching what they do."""

from __future__ import annotations

import errno
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
from dataclasses import dataclass, replace
from pathlib import Path

from carecontact.errors import RecordingError
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import open_recording, read_header, write_recording
from carecontact.recording.file import no_space
from carecontact.recording.schema import FAILED, KILLED, Recording
from carecontact.running.engine import Ended, RunSettings, StatusPipe, TrialRequest
from carecontact.running.fork_server import PROCESS_STATUS, STATUS_FD
from carecontact.running.lost import Losses, harness_error_recording, lack_in, tail
from carecontact.running.worker import worker_environment
from carecontact.runs.manifest import runs_beside
from carecontact.serving.conversation import WAIT_REPORT_S, readable
from carecontact.serving.process_tree import readable_descriptors

# -P: the folder a user happens to stand in must not shadow a module of the trial's process.
PYTHON = (sys.executable, "-P", "-X", "faulthandler", "-m")
WORKER_COMMAND = (*PYTHON, "carecontact.running.worker")
SERVER_COMMAND = (*PYTHON, "carecontact.running.fork_server")
PATIENCE_S = 60.0
"""Longest wait for a message of the fork server, which takes a second to start [s]."""
ROOM_BYTES = 48 << 20
"""Free space that a trial needs to begin: a whole trial takes 2 MB, and its policy's notes may take 32 MB more
(MAX_NOTES_BYTES of ``episode.log``)."""


class ServerLostError(Exception):
    """The fork server does not answer, or is gone."""


class Launcher:
    """Starts workers, each in a process group of its own: forked from a process that has imported everything, or as a
    program."""

    def __init__(self, command: Sequence[str] = WORKER_COMMAND, *, forks: bool = True) -> None:
        """
        Args:
            command: of a worker as a program, to which the id of its parent is added; any other than WORKER_COMMAND is
                never forked.
            forks: whether to fork, where the system can.
        """
        self.command = tuple(command)
        self._forks = forks and self.command == WORKER_COMMAND and hasattr(os, "pidfd_open")
        self._server: tuple[subprocess.Popen[bytes], socket.socket] | None = None

    def begin(self) -> None:
        """Start the fork server, if there is to be one, so that it imports while the caller does something else."""
        if self._forks:
            with suppress(OSError):  # The first ``start`` tries again.
                self._serving()

    def start(self, request: TrialRequest, *, log: Path) -> Process:
        """``request`` with a ``status_fd``; ``log``: file for what the worker prints."""
        assert request.status_fd is not None
        with log.open("wb") as output:
            if self._forks:
                try:
                    return self._forked(request, request.status_fd, output.fileno())
                except ServerLostError:
                    # Not again in this run: a program of its own has not what ails the server, or says so.
                    self._forks = False
                    self.close()
            process = subprocess.Popen(
                (*self.command, str(os.getpid())),
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=worker_environment(),
                pass_fds=(request.status_fd,),
                start_new_session=True,
            )
        assert process.stdin is not None
        # A worker that is dead already is found so when it is polled.
        with suppress(BrokenPipeError), process.stdin as stdin:
            stdin.write(request.model_dump_json().encode())
        return process

    def close(self) -> None:
        """End the fork server; the kernel ends what it forked."""
        if self._server is not None:
            server, line = self._server
            line.close()
            server.kill()
            server.wait()
        self._server = None

    def _forked(self, request: TrialRequest, status_fd: int, output_fd: int) -> ForkedProcess:
        server, line = self._serving()
        theirs, requests = os.pipe()
        news, reports = os.pipe()
        with open(requests, "wb", 0) as stdin:
            try:
                socket.send_fds(line, [b"w"], [theirs, output_fd, status_fd, reports])
            except OSError:
                os.close(news)
                raise ServerLostError from None
            finally:
                os.close(theirs)
                os.close(reports)
            process = ForkedProcess(server, news)
            own = request.model_copy(update={"status_fd": STATUS_FD})
            with suppress(BrokenPipeError):
                stdin.write(own.model_dump_json().encode())
        return process

    def _serving(self) -> tuple[subprocess.Popen[bytes], socket.socket]:
        if self._server is None:
            line, far = socket.socketpair()
            with far:
                server = subprocess.Popen(
                    (*SERVER_COMMAND, str(os.getpid())),
                    stdin=far.fileno(),
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=worker_environment(),
                    start_new_session=True,
                )
            self._server = server, line
        return self._server


class ForkedProcess:
    def __init__(self, server: subprocess.Popen[bytes], news: int) -> None:
        """``news``: descriptor to read from, which this object then owns."""
        self.returncode: int | None = None
        self._server, self._news = server, news
        pid = self._next()
        if pid is None or pid < 0:
            os.close(news)
            raise ServerLostError if pid is None else OSError(-pid, os.strerror(-pid))
        self.pid = pid

    def poll(self) -> int | None:
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


Process = subprocess.Popen[bytes] | ForkedProcess


def kill_tree(process: Process) -> None:
    """Kill the worker with its process group. Its policy, which has a session of its own, ends with it."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def available_cores() -> int:
    """Return the number of cores that this process may use, which inside a container are fewer than the machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True, kw_only=True)
class Worker:
    """The process of a trial that runs, and its files."""

    spec: TrialSpec
    process: Process
    partial: Path
    output: Path
    status: StatusPipe
    started: float

    def lack(self) -> str:
        """Return why the trial could not begin to ask its policy, if it lacked a process, a thread or memory."""
        with suppress(RecordingError):
            if not self.status.policy_runs and not self.status.answers:
                return lack_in(read_header(self.partial))
        return ""

    def recording(self) -> tuple[Recording | None, str]:
        """Return the trial's recording, or None and what is wrong with it."""
        try:
            # A complete file counts even if the interpreter then crashed, as graphics drivers do while it shuts down.
            recording = open_recording(self.partial)
        except RecordingError as error:
            return None, str(error)
        if recording.header.spec == self.spec.sealed:
            return recording, ""
        return None, f"the worker recorded another trial, {recording.header.spec.trial_id}"

    def death(self, *, timed_out: bool, limit_s: float) -> tuple[str, str]:
        """Return the kind and the description of the process's end, in case that it left no recording."""
        code = self.process.wait()
        if timed_out:
            return "timeout", f"the trial's process ran longer than {limit_s:g} s and was killed"
        if code < 0:
            return KILLED, f"the trial's process died of signal {-code} ({signal.strsignal(-code)})"
        if code > 0:
            return "exit", f"the trial's process ended with status {code} and wrote no recording"
        return "no_recording", "the trial's process ended with status 0 but its recording cannot be read"


class Workers:
    """The engine ``local``: the trials of one run, each in a process of this machine."""

    def __init__(self, run: RunSettings, launcher: Launcher) -> None:
        """``launcher``: its maker closes it, because it may also start the workers of other runs."""
        self._run, self._launcher = run, launcher
        self._losses = Losses(run.policy, out=run.out, before=run.killed)
        self.running: list[Worker] = []

    def slots(self) -> int:
        return available_cores()

    def start(self, spec: TrialSpec) -> None:
        # Neither a name nor a command line may show the policy, which can read both, what it is tried on.
        folder = Path(tempfile.mkdtemp(dir=self._run.work))
        partial, output = folder / "trial.h5", folder / "output.txt"
        pipe, status_fd = os.pipe()
        # Again for each trial: another command may have begun a run beside this one.
        closed = tuple(dict.fromkeys((*self._run.policy.closed, *runs_beside(self._run.out))))
        request = TrialRequest(
            spec=spec,
            policy=replace(self._run.policy, closed=closed),
            out=partial.resolve(),
            weights=self._run.weights,
            pace_s=self._run.pace_s,
            status_fd=status_fd,
        )
        try:
            process = self._launcher.start(request, log=output)
        except OSError:
            os.close(pipe)
            shutil.rmtree(folder, ignore_errors=True)
            raise
        finally:
            os.close(status_fd)
        status, now = StatusPipe(pipe), time.monotonic()
        self.running.append(
            Worker(spec=spec, process=process, partial=partial, output=output, status=status, started=now)
        )

    def finished(self) -> list[Ended]:
        """Reap the workers that have ended, were stopped or ran out of time."""
        return [ended for worker in list(self.running) if (ended := self._reaped(worker)) is not None]

    def waiting(self) -> dict[str, str]:
        """Trial id -> a line about a policy that was silent just now."""
        since = time.monotonic() - 2 * WAIT_REPORT_S
        statuses = {worker.spec.trial_id: worker.status for worker in self.running}
        return {trial_id: status.said["waiting"] for trial_id, status in statuses.items() if status.waited_s > since}

    def kill_all(self) -> None:
        for worker in self.running:
            kill_tree(worker.process)
            worker.status.close()
        self.running.clear()

    def _reaped(self, worker: Worker) -> Ended | None:
        """Return how a worker ended; None while it runs."""
        spec, status, limit_s = worker.spec, worker.status, self._run.trial_limit_s
        status.read()
        timed_out = time.monotonic() - worker.started > limit_s
        if worker.process.poll() is None and not timed_out:
            return None
        self.running.remove(worker)
        kill_tree(worker.process)
        status.read()
        status.close()
        if (unreached := status.said.get("unreached")) is not None:
            return Ended(spec=spec, kind="unreached", why=unreached)
        if (place := status.said.get("unstored")) is not None:
            why = readable(place) or str(no_space(self._run.out, os.strerror(errno.ENOSPC)))
            return Ended(spec=spec, kind="unstored", why=why)
        if lack := worker.lack():
            return Ended(spec=spec, kind="lacked", why=lack)
        kind, death = worker.death(timed_out=timed_out, limit_s=limit_s)
        recording = self._collected(worker, kind, death)
        if isinstance(recording, str):
            return Ended(spec=spec, kind="lost", why=recording)
        os.replace(worker.partial, self._run.out / f"{spec.trial_id}.h5")
        self._keep_log(worker, recording)
        warnings = tuple(map(readable, status.said["warnings"])) if "warnings" in status.said else None
        return Ended(spec=spec, kind="recorded", recording=recording, warnings=warnings)

    def _collected(self, worker: Worker, kind: str, death: str) -> Recording | str:
        """Return the recording, which is then in ``worker.partial``, or why the trial has to run once more."""
        found, problem = worker.recording()
        spec, status, losses = worker.spec, worker.status, self._losses
        evidence = f"\n\n{tail(worker.output.read_text(errors='replace')) or '(no output)'}"
        if kind == "no_recording":
            death += f": {problem}"
        lack = "" if found is None else lack_in(found.header)
        if found is not None and not lack:
            outcome = losses.ended(found, status.answers)
        elif lack or status.policy_runs or kind == KILLED:
            starved = bool(lack) or kind == "timeout"
            outcome = losses.died(
                spec, status.answers, lack or death, evidence, with_policy=status.policy_runs, starved=starved
            )
        else:
            outcome = harness_error_recording(spec, kind=kind, message=death + evidence)
        if isinstance(outcome, Recording) and outcome is not found:
            write_recording(outcome, worker.partial)
        return outcome

    def _keep_log(self, worker: Worker, recording: Recording) -> None:
        trial_id, failure = worker.spec.trial_id, recording.header.failure
        log = self._run.out / f"{trial_id}.log"
        if recording.header.ended not in FAILED or failure is None:
            log.unlink(missing_ok=True)
            return
        output = worker.output.read_text(errors="replace").strip()
        head = f"{trial_id} {recording.header.ended} ({failure.kind})\n{failure.message}\n"
        printed = f"\nthe trial's process printed:\n{output}\n" if output else ""
        worker.output.write_text(head + printed, errors="replace")
        os.replace(worker.output, log)
