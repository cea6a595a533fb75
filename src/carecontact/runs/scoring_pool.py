"""Processes that score recordings, each at the end of a socket.

The pools of the standard library lose all work if one process dies, and a killed command leaves their named semaphores
in ``/dev/shm``.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path
from threading import local
from typing import TYPE_CHECKING

from carecontact.exhausted import is_exhausted

if TYPE_CHECKING:
    from carecontact.runs.score_files import ScoredFile

COMMAND = (sys.executable, "-P", "-m", "carecontact.runs.scoring_process")


class ScoringLostError(Exception):
    """A scoring process died or could not be started; the next recording gets a new one."""


class ScoringPool:
    """Threads, each with a process that scores one recording after another. Its maker closes it."""

    def __init__(self, processes: int) -> None:
        """A thread starts its process when there is work for it. With 0 processes, a thread of this process scores."""
        self._inside = processes == 0
        self._threads = ThreadPoolExecutor(max(1, processes))
        self._own = local()
        self._started: list[_Process] = []

    def submit(
        self, path: Path, *, then: Callable[[ScoredFile | str], None] = lambda found: None
    ) -> Future[ScoredFile | str]:
        """Return what will have the result of ``score_file``, or ScoringLostError.

        ``then``: called with the result before the future has it, in the pool's thread.
        """

        def score() -> ScoredFile | str:
            found = self._score(path)
            then(found)
            return found

        try:
            return self._threads.submit(score)
        except RuntimeError as error:
            if not is_exhausted(error):
                raise
            lost: Future[ScoredFile | str] = Future()
            lost.set_exception(ScoringLostError())
            return lost

    def close(self) -> None:
        """Leave unscored what is not scored yet, and end the processes."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._started:
            process.end()
        self._threads.shutdown()
        # Those that a thread was just about to start.
        for process in self._started:
            process.end()

    def _score(self, path: Path) -> ScoredFile | str:
        if self._inside:
            from carecontact.runs.score_files import score_file

            return score_file(path)
        process: _Process | None = getattr(self._own, "process", None)
        try:
            if process is None:
                process = self._own.process = _Process()
                self._started.append(process)
            return process.score(path)
        except (EOFError, OSError):
            if process is not None:
                process.end()
            self._own.process = None
            raise ScoringLostError from None


class _Process:
    def __init__(self) -> None:
        near, far = socket.socketpair()
        with far:
            # In a session of its own, so that Ctrl-C reaches the parent alone.
            self._process = subprocess.Popen(
                (*COMMAND, str(os.getpid())), stdin=far.fileno(), stdout=subprocess.DEVNULL, start_new_session=True
            )
        self._line: Connection = Connection(near.detach())
        self._line.send(sys.path)

    def score(self, path: Path) -> ScoredFile | str:
        """Raises EOFError or OSError if the process is gone, and whatever scoring raises."""
        self._line.send(path)
        found: ScoredFile | str | Exception = self._line.recv()
        if isinstance(found, Exception):
            raise found
        return found

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
