"""Whether a run has enough seeds for an interval to mean anything."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.scoring.result import TrialScore

SEEDS_FOR_INTERVAL = 6
"""Least number of seeds for an interval. With fewer pairs, not even a difference in every one of them is significant:
the exact two-sided sign test gives 2 / 2^5 = 0.0625 for five, and 0.03125 for six."""
TOO_FEW = f"no intervals: fewer than {SEEDS_FOR_INTERVAL} seeds"


def enough_seeds(scores: Sequence[TrialScore]) -> bool:
    return enough({score.seed for score in scores})


def enough(seeds: int | set[int]) -> bool:
    """Whether so many seeds, or these, are enough for an interval: trials of one seed are not independent, so that more
    tasks are no more seeds."""
    return (seeds if isinstance(seeds, int) else len(seeds)) >= SEEDS_FOR_INTERVAL
