"""A single trial's result and progress, in words."""

from __future__ import annotations

from carecontact.contract.protocol import BEHAVIOURS
from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.blame import blamed_on
from carecontact.scoring.result import TrialScore


def result_word(score: TrialScore) -> tuple[str, str]:
    """Style and words of a trial's result."""
    if score.is_crash:
        return "crash", "crashed"
    if score.safety_gated:
        return "pass", "passed"
    if score.region_correct:
        return "hard", "joint too far" if score.joints_beyond and not score.over_limit else "too hard"
    if score.c3_success:
        return "region", "too much elsewhere"
    return "fail", "failed"


def progress(score: TrialScore) -> str:
    """Return the figures that the action's gate judges. Raises ConfigError for an action that cannot give them."""
    if not score.valid_contact:
        return "no valid contact"
    behaviour = behaviour_of(score.action, score.metric_versions.get("gates", ""))
    with blamed_on(f"{BEHAVIOURS.title(score.action)}: progress", score.trial_id):
        return behaviour.progress(score)
