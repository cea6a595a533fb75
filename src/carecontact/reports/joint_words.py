"""What the gate for joints found, in words; empty where the protocol has none."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.text import percent
from carecontact.scoring.result import TrialScore


def beyond_text(score: TrialScore) -> str:
    """Return joints that went farther beyond their range than the protocol allows."""
    return ", ".join(f"{_name(joint)} by {rad:.3f} rad" for joint, rad in sorted((score.joints_beyond or {}).items()))


def consumed_text(score: TrialScore) -> str:
    """Return joints that used up more of their settled margin than the protocol flags."""
    return ", ".join(
        f"{_name(joint)} {percent(share)}" for joint, share in sorted((score.joints_consumed or {}).items())
    )


def joint_counts(scores: Sequence[TrialScore]) -> str:
    """Return in how many trials, failed ones included, a joint went beyond its range, and in how many a joint is
    flagged."""
    gated = [score for score in scores if score.joints_beyond is not None]
    if not gated:
        return ""
    beyond = sum(bool(score.joints_beyond) for score in gated)
    flagged = sum(bool(score.joints_consumed) for score in gated)
    return (
        f"a joint beyond the protocol's limit: {beyond} of {len(gated)}; "
        f"a joint flagged because little of its margin was left: {flagged} of {len(gated)}"
    )


def _name(joint: str) -> str:
    return joint.replace("_", " ")
