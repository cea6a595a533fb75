"""Numbers and names as every table and page writes them."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.errors import counted
from carecontact.scoring.result import TrialScore

NA = "NA"
NOT_DEFINED = "–"
"""Marks a score that is not pooled over this task. NA, in contrast, means that no trial had a value."""
NAMED = 10
"""Number of trials that a sentence names; it only counts any further ones."""


def number(value: float | None, digits: int) -> str:
    return NA if value is None else f"{value:.{digits}f}"


def shown(value: float | None, *, digits: int | None, unit: str) -> str:
    """Return a value as its metric wants it: with ``digits`` decimals, or about three digits; angles as ``angle``."""
    if digits is not None:
        return number(value, digits)
    return angle(value) if unit == "rad" else rounded(value)


def rounded(value: float | None) -> str:
    """About three digits, never a power of ten: these numbers span four decades."""
    if value is None:
        return NA
    if abs(value) < 0.0005:
        return "0"
    for below, digits in ((10.0, 2), (100.0, 1)):
        text = f"{value:.{digits}f}"
        if abs(float(text)) < below:
            return text
    return f"{value:.0f}"


def angle(value: float | None) -> str:
    """[rad]; margins at a joint limit are of the order of 1e-4, so small ones are written in powers of ten."""
    if value is None:
        return NA
    if not 0 < abs(value) < 1e-2:
        return f"{value:.3f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def percent(fraction: float) -> str:
    return f"{100 * fraction:.0f}\N{NO-BREAK SPACE}%"


def task_name(score: TrialScore) -> str:
    return f"{score.action} {score.region.replace('_', ' ')}".capitalize()


def listed(names: Sequence[str]) -> str:
    """Return the first NAMED, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def clipped_text(scores: Sequence[TrialScore]) -> str:
    """Return how often the benchmark moved a target onto the border of the workspace; empty if never."""
    trials = [s for s in scores if s.clipped_actions]
    if not trials:
        return ""
    return (
        f"In {len(trials)} of {counted(len(scores), 'trial')} the benchmark moved targets outside the workspace onto "
        f"its border ({counted(sum(s.clipped_actions for s in trials), 'action')} in all), as the policy's card "
        "requests. The robot did not do there what the policy commanded."
    )


def crashed_text(scores: Sequence[TrialScore]) -> str:
    """Return in which trials the policy crashed; empty if in none."""
    crashed = [score.trial_id for score in scores if score.is_crash]
    return f"crashed in {len(crashed)}: {listed(crashed)}" if crashed else ""
