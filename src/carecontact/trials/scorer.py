"""Scores recordings as they come, so that a run of many trials does not end with scoring."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from pathlib import Path
from threading import Event

from carecontact.errors import RecordingError
from carecontact.recording import stored_sha256
from carecontact.runs.score_files import ScoredFile
from carecontact.runs.scoring_pool import ScoringLostError, ScoringPool
from carecontact.scoring.result import TrialScore

SHARE = 4
"""Cores for each process: a trial takes some ten times as long as its score."""
FEW = 24
"""Least number of trials for another process: for fewer, a process that first has to import everything costs more than
it saves."""


class Scorer:
    """Each recording that it is given is scored once, in a thread or, where there are many, in processes, which start
    when there is work for them. Its maker closes it.
    """

    def __init__(self, cores: int, *, trials: int) -> None:
        """Start nothing yet.

        Args:
            cores: number of cores that trials and scores share.
            trials: how many there may be.
        """
        self._pool = ScoringPool(max(1, cores // SHARE) if trials >= FEW else 0)
        self._given: dict[Path, Future[ScoredFile | str]] = {}
        self._told: list[Event] = []

    def give(self, path: Path, *, then: Callable[[TrialScore], None] = lambda score: None) -> None:
        """Score a recording that will not change any more; nobody waits. Where a process died, it stays unscored.

        Args:
            then: called with the score, in another thread.
        """

        told = Event()

        def tell(given: Future[ScoredFile | str]) -> None:
            with suppress(ScoringLostError, CancelledError):
                if not isinstance(found := given.result(), str):
                    then(found.score)
            told.set()

        self._given.pop(path, None)
        self._given[path] = self._pool.submit(path)
        self._told.append(told)
        self._given[path].add_done_callback(tell)

    def fill(self, paths: Iterable[Path]) -> None:
        """Give those recordings that it does not have."""
        for path in paths:
            if path not in self._given:
                self.give(path)

    def take(self, path: Path) -> ScoredFile | None:
        """Wait for the score of a recording and forget it.

        None where it was not given, could not be scored, or the file has become another one: score it then as if there
        were no ``Scorer``, which also says what is wrong.
        """
        if (given := self._given.pop(path, None)) is None:
            return None
        try:
            found = given.result()
            same = not isinstance(found, str) and stored_sha256(path) == found.score.recording_sha256
        except (ScoringLostError, CancelledError, RecordingError):
            return None
        return found if same and not isinstance(found, str) else None

    def score_of(self, path: Path) -> TrialScore | None:
        """Wait for the score of a recording; None where it cannot be scored."""
        self.fill([path])
        with suppress(KeyError, ScoringLostError, CancelledError):
            found = self._given[path].result()
            return None if isinstance(found, str) else found.score
        return None

    def wait(self) -> None:
        """Wait until every recording is scored and its score told."""
        for told in self._told:
            told.wait()

    def close(self) -> None:
        """Leave what has not begun unscored."""
        self._pool.close()
