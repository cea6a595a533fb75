"""Sections about what went wrong: each cause with its picture, crashes with their messages, and tables of failures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.recording.reason import PRINTED, TRACEBACK, alike, remedies
from carecontact.report.failures import Cause, anatomy, causes, failure_modes, only_crashes
from carecontact.report.links import shortened
from carecontact.report.run_page import FOLD, Page, section
from carecontact.report.tables import POOLED
from carecontact.report.words import listed
from carecontact.scoring.result import TrialScore

PICTURED = 6
"""Number of causes above the fold; the table below it has them all."""
MOST = 12
"""Number of different crashes that the page shows."""
NO_REASON = "no reason recorded"


@dataclass(frozen=True, kw_only=True)
class Crash:
    """Trials that crashed for one reason, and the whole message of the first."""

    trials: str
    first: str
    reason: str
    hints: tuple[str, ...]
    """What may help."""
    message: str
    held: str
    """What the message holds beside the reason, in words; empty where it is the reason alone."""


@section("failures", "Failures", order=30)
def failures(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    crashed = crashes(page.judged)
    return {
        "trials": page.trials,
        "failed": sum(score.failure_mode is not None for score in page.judged),
        "unsafe": sum(not score.safety_gated for score in page.judged),
        "rows": pictured(page),
        "more_causes": len(causes(page.judged)[PICTURED:]),
        "n_crashed": sum(score.is_crash for score in page.judged),
        "n_over": sum(score.is_crash and bool(score.over_limit) for score in page.judged),
        "crashes": crashed[:MOST],
        "more": len(crashed[MOST:]),
    }


def pictured(page: Page) -> Sequence[tuple[Cause | None, Any]]:
    """Return each cause above the fold with its picture, None without one; where no trial failed, the hardest contact
    alone."""
    frames = page.kept["peak"]
    found = [(cause, frames.get((cause.name, cause.meaning))) for cause in causes(page.judged)[:PICTURED]]
    hardest = max(frames.values(), key=lambda frame: frame.score.c1_peak_force_n or 0.0, default=None)
    return found or ([] if hardest is None else [(None, hardest)])


@section("causes", "Why trials failed", order=FOLD + 60)
def causes_section(page: Page) -> dict[str, Any] | None:
    """Tables of failure modes, of causes with their evidence, and of where contact was."""
    if not page.judged:
        return None
    return {
        "trials": page.trials,
        "failed": sum(score.failure_mode is not None for score in page.judged),
        "modes": failure_modes(page.judged),
        "causes": causes(page.judged),
        "anatomy": [] if only_crashes(page.judged) else anatomy(page.judged),
        "pooled": POOLED,
    }


def crashes(scores: Sequence[TrialScore]) -> list[Crash]:
    """Return one row for each reason, in the order of the trials."""
    groups: dict[str, list[TrialScore]] = {}
    for score in scores:
        if score.is_crash:
            groups.setdefault(alike(score.evidence or NO_REASON), []).append(score)
    return [
        Crash(
            trials=listed([score.trial_id for score in group]),
            first=group[0].trial_id,
            reason=shortened(group[0].evidence or NO_REASON),
            hints=tuple(remedies(group[0].failure_message or "")),
            message=group[0].failure_message or "",
            held=_held(group[0].failure_message or "", group[0].evidence or ""),
        )
        for group in groups.values()
    ]


def _held(message: str, reason: str) -> str:
    if message.strip() in reason:
        return ""
    before, printed, _ = message.partition(PRINTED)
    held = ["traceback" if TRACEBACK in before else "stack"] if "(most recent call last)" in before else []
    return (" and ".join([*held, *(["last output"] if printed else [])]) or "whole message").capitalize()
