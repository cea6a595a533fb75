"""Scores recordings as they come, in processes that each end with a socket to this one, or in a thread.

The pools of the standard library lose all work if one process dies, and a killed command leaves their named semaphores
in ``/dev/shm``.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from threading import local

from carecontact.errors import RecordingError
from carecontact.recording import read_recording, stored_sha256
from carecontact.scoring.result import TrialScore
from carecontact.scoring.score import score_recording
from carecontact.system import die_with_parent, is_exhausted

COMMAND = (sys.executable, "-P", "-c", "from carecontact.runs.scorer import main; main()")
"""A process that scores: it is given the id of this one, with a socket to it as standard input."""
SHARE = 4
"""Cores for each process: a trial takes some ten times as long as its score."""
FEW = 24
"""Least number of trials for another process: for fewer, a process that first has to import everything costs more than
it saves."""


@dataclass(frozen=True, kw_only=True)
class ScoredFile:
    score: TrialScore
    versions: dict[str, str]
    """Package -> version that the recording names."""


Found = ScoredFile | str
"""The score of a file, or in one line why it has none."""


class ScoringLostError(Exception):
    """A scoring process died or could not be started; the next recording gets a new one."""


def score_file(path: Path) -> Found:
    try:
        recording = read_recording(path)
        trial_id = recording.header.spec.trial_id
        if path.stem != trial_id:
            remedy = f"rename the file to {trial_id}.h5, or remove it if it is a copy"
            raise RecordingError(f"{path}: holds trial {trial_id}; {remedy}")
        return ScoredFile(score=score_recording(recording), versions=recording.header.versions)
    except RecordingError as error:
        return str(error)


def score_files(paths: Sequence[Path], *, jobs: int) -> Iterator[Found]:
    """Score recordings and return the scores in the order of ``paths``."""
    if jobs <= 1:
        yield from map(score_file, paths)
        return
    with closing(ScoringPool(jobs)) as pool:
        given = [pool.submit(path) for path in paths]
        try:
            yield from (each.result() for each in given)
        except ScoringLostError:
            raise RecordingError(
                f"{paths[0].parent}: a scoring process died; score again with --jobs 1 to see at which recording"
            ) from None


class ScoringPool:
    """Threads, each with a process that scores one recording after another. Its maker closes it."""

    def __init__(self, processes: int) -> None:
        """A thread starts its process when there is work for it. With 0 processes, a thread of this process scores."""
        self._inside = processes == 0
        self._threads = ThreadPoolExecutor(max(1, processes))
        self._own = local()
        self._started: list[_Process] = []

    def submit(self, path: Path, *, then: Callable[[TrialScore], None] = lambda score: None) -> Future[Found]:
        """Return what will have the result of ``score_file``. ``then``: gets a score before, in the pool's thread."""

        def score() -> Found:
            found = self._score(path)
            if isinstance(found, ScoredFile):
                then(found.score)
            return found

        try:
            return self._threads.submit(score)
        except RuntimeError as error:
            if not is_exhausted(error):
                raise
            lost: Future[Found] = Future()
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

    def _score(self, path: Path) -> Found:
        if self._inside:
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


class Scorer(ScoringPool):
    """Scores each recording that it is given once, so that a run of many trials does not end with scoring."""

    def __init__(self, cores: int, *, trials: int) -> None:
        """``cores``: that trials and scores share; ``trials``: how many there may be."""
        super().__init__(max(1, cores // SHARE) if trials >= FEW else 0)
        self._given: dict[Path, Future[Found]] = {}

    def give(self, path: Path, *, then: Callable[[TrialScore], None] = lambda score: None) -> None:
        """Score a recording that will not change any more, without waiting; ``then`` gets the score in a thread."""
        self._given[path] = self.submit(path, then=then)

    def fill(self, paths: Iterable[Path]) -> None:
        for path in paths:
            if path not in self._given:
                self.give(path)

    def take(self, path: Path) -> ScoredFile | None:
        """Wait for the score of a recording and forget it. None where it was not given, could not be scored, or the
        file has become another one: score it then as if there were no ``Scorer``, which also says what is wrong."""
        found = _score_in(self._given.pop(path, None))
        with suppress(RecordingError):
            if found is not None and stored_sha256(path) == found.score.recording_sha256:
                return found
        return None

    def score_of(self, path: Path) -> TrialScore | None:
        """Wait for the score of a recording; None where it cannot be scored."""
        self.fill([path])
        found = _score_in(self._given[path])
        return None if found is None else found.score

    def wait(self) -> None:
        """Wait until every recording is scored and its score handed on."""
        for each in list(self._given.values()):
            _score_in(each)


def _score_in(given: Future[Found] | None) -> ScoredFile | None:
    """Wait for a score; None where there is none, its process died, or the pool was closed before."""
    with suppress(ScoringLostError, CancelledError):
        found = None if given is None else given.result()
        return found if isinstance(found, ScoredFile) else None
    return None


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

    def score(self, path: Path) -> Found:
        self._line.send(path)
        found: Found | Exception = self._line.recv()
        if isinstance(found, Exception):
            raise found
        return found

    def end(self) -> None:
        self._process.kill()
        self._process.wait()


def main() -> None:
    """Score what the parent sends: first the search path for modules, then paths of recordings."""
    die_with_parent(int(sys.argv[1]))
    with Connection(os.dup(0)) as line, suppress(EOFError):
        sys.path[:] = line.recv()
        while True:
            path = line.recv()
            try:
                line.send(score_file(path))
            except Exception as error:
                line.send(error)
