"""Starts workers: each is forked from a process that has imported everything, or started as a program of its own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from carecontact.hosting.readable import readable
from carecontact.trials.fork_server import NEWS, TOLD_FD
from carecontact.trials.request import TrialRequest
from carecontact.trials.worker import SINGLE_THREAD, WITHOUT_WINDOWS

# -P: the folder a user happens to stand in must not shadow a module of the trial's process.
PYTHON = (sys.executable, "-P", "-X", "faulthandler", "-m")
WORKER_COMMAND = (*PYTHON, "carecontact.trials.worker")
SERVER_COMMAND = (*PYTHON, "carecontact.trials.fork_server")
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
            own = request.model_copy(update={"told_fd": TOLD_FD})
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
        if self.returncode is None and readable([self._news], 0.0):
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
        if not readable([self._news], PATIENCE_S):
            self._server.kill()
        piece = os.read(self._news, NEWS.size)
        return NEWS.unpack(piece)[0] if piece else None


def is_stopped(pid: int) -> bool:
    """Whether somebody sent the process SIGSTOP, where the system says so: nothing in the harness does."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0] == "T"
    return False


def _environment() -> dict[str, str]:
    return {**WITHOUT_WINDOWS, **os.environ, **SINGLE_THREAD, "PYTHONHASHSEED": "0"}
