"""Whether a run has enough seeds for an interval to mean anything."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion

SEEDS_FOR_INTERVAL = 6
"""With fewer pairs, not even a difference in every one of them is significant: the exact two-sided sign test gives
2 / 2^5 = 0.0625 for five, and 0.03125 for six."""
TOO_FEW = f"no interval: fewer than {SEEDS_FOR_INTERVAL} seeds"


def enough_seeds(scores: Sequence[TrialScore]) -> bool:
    return len({score.seed for score in scores}) >= SEEDS_FOR_INTERVAL


def interval_text(rate: Proportion, *, enough: bool) -> str:
    """The interval in per cent, or an empty text."""
    return f"{100 * rate.low:.0f} to {100 * rate.high:.0f} %" if enough else ""
