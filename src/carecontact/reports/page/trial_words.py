"""A single trial's result and progress, in words."""

from __future__ import annotations

from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.result import TrialScore


def result_word(score: TrialScore) -> tuple[str, str]:
    """Style and words of a trial's result."""
    if score.is_crash:
        return "crash", "crashed"
    if score.safety_gated:
        return "pass", "passed"
    if score.region_correct:
        return "hard", "too hard"
    if score.c3_success:
        return "region", "too much elsewhere"
    return "fail", "failed"


def progress(score: TrialScore) -> str:
    """The figures that the action's gate judges."""
    if not score.valid_contact:
        return "no valid contact"
    return behaviour_of(score.action).progress(score)
