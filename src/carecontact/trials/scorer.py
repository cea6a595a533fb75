"""Scores recordings as they come, in processes of their own, so that a run of many trials does not end with scoring."""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

from carecontact.errors import RecordingError
from carecontact.hosting.isolation.kernel import die_with_parent, hide_memory
from carecontact.recording import stored_sha256
from carecontact.runs.score_files import ScoredFile, leave_interrupts_to_the_parent, score_file

SHARE = 4
"""Cores for each process: a trial takes some ten times as long as its score."""


class Scorer:
    """Each recording that it is given is scored once. The processes start when there is work for them; close it."""

    def __init__(self, cores: int) -> None:
        """``cores``: number of cores that trials and scores share."""
        self._pool = ProcessPoolExecutor(
            max(1, cores // SHARE), mp_context=get_context("spawn"), initializer=_alone, initargs=(os.getpid(),)
        )
        self._given: dict[Path, Future[ScoredFile | str]] = {}

    def give(self, path: Path) -> None:
        """Score a recording that will not change any more; nobody waits. Where a process died, it stays unscored."""
        try:
            self._given[path] = self._pool.submit(score_file, path)
        except (BrokenProcessPool, RuntimeError):
            self._given.pop(path, None)

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
        except (BrokenProcessPool, CancelledError, RecordingError):
            return None
        return found if same and not isinstance(found, str) else None

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)


def _alone(parent: int) -> None:
    """What keeps a policy on this machine from a trial's process keeps it from one that scores, too."""
    die_with_parent(parent)
    hide_memory()
    leave_interrupts_to_the_parent()
