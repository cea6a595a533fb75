"""A single trial's result and progress, in words."""

from __future__ import annotations

from carecontact.scoring.result import TrialScore


def result_word(score: TrialScore) -> tuple[str, str]:
    """Style and words of a trial's result."""
    if score.safety_gated:
        return "pass", "passed"
    if score.region_correct:
        return "hard", "too hard"
    if score.c3_success:
        return "region", "off region"
    return "fail", "failed"


def progress(score: TrialScore) -> str:
    """The figures that the action's gate looks at."""
    if not score.valid_contact:
        return "no valid contact"
    if score.action == "touch":
        return f"on {score.longest_on_s:.2f} s"
    if score.action == "push":
        return f"wrist {1000 * score.wrist_displacement_m:.0f} mm, on {score.longest_on_s:.2f} s"
    reversals = "1 reversal" if score.reversals == 1 else f"{score.reversals} reversals"
    return f"stroke {1000 * score.stroke_m:.0f} mm, extent {1000 * score.extent_m:.0f} mm, {reversals}"
