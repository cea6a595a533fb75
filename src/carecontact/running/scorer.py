"""Scores recordings as they come, so that a run of many trials does not end with scoring."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from pathlib import Path

from carecontact.errors import RecordingError
from carecontact.recording import stored_sha256
from carecontact.runs.scoring import ScoredFile, ScoringLostError, ScoringPool
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
        self._begun: list[Future[ScoredFile | str]] = []

    def give(self, path: Path, *, then: Callable[[TrialScore], None] = lambda score: None) -> None:
        """Score a recording that will not change any more; nobody waits. Where a process died, it stays unscored.

        Args:
            then: called with the score, in another thread.
        """

        def tell(found: ScoredFile | str) -> None:
            if not isinstance(found, str):
                then(found.score)

        self._given[path] = self._pool.submit(path, then=tell)
        self._begun.append(self._given[path])

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
        given = self._given.pop(path, None)
        found = None if given is None else _score_in(given)
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
        """Wait until every recording is scored and its score told."""
        for each in self._begun:
            _score_in(each)

    def close(self) -> None:
        """Leave what has not begun unscored."""
        self._pool.close()


def _score_in(given: Future[ScoredFile | str]) -> ScoredFile | None:
    """Wait for a score; None where there is none, its process died, or the pool was closed before."""
    with suppress(ScoringLostError, CancelledError):
        found = given.result()
        return None if isinstance(found, str) else found
    return None
