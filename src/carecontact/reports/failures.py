"""Why trials failed: failure modes, causes with their evidence, and where the contact was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.reports.cause_words import cause_text
from carecontact.reports.evidence_words import evidence_text
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore

MODE_MEANING = {
    "process_failure": (
        "the policy did not start, died, hung or answered wrongly, or its program or its language backend failed"
    ),
    "safety_truncation": (
        "the benchmark stopped the trial, because a force exceeded the truncation limit, the robot was too fast or the "
        "solver failed"
    ),
    "no_target_contact": "no contact with the person was strong and long enough to count",
    "off_target_contact": "the person was touched, but never on the named region",
    "not_by_tool": "the region was touched mostly by the robot's hand or links, not by its tool",
    "lost_contact": "contact with the region broke off before the gate was met",
    "insufficient_progress": (
        "touched, but the touch was too short, the push too small, or the strokes or turns too few"
    ),
    "outside_band": "done, but too hard, too lightly or too far",
    "wrong_share": "gate met, but too much of the contact lay elsewhere",
    "time_limit": "still under way when the time ran out",
    "joint_beyond_range": (
        "succeeded on the named region, but moved a joint farther beyond its range than the protocol allows"
    ),
}
EXAMPLES = 2
"""Number of pieces of evidence that are shown for a cause."""


@dataclass(frozen=True, kw_only=True)
class Cause:
    name: str
    meaning: str
    """What happened, as ``cause_text`` says it."""
    count: int
    examples: tuple[tuple[str, str], ...]
    """Trial and evidence of the first EXAMPLES, from different tasks where there are."""


@dataclass(frozen=True, kw_only=True)
class AnatomyRow:
    """One region; ``process_failure + target + off_target + none`` is ``n``."""

    region: str
    n: int
    target: int
    off_target: int
    none: int
    process_failure: int
    success: int


def only_crashes(scores: Sequence[TrialScore]) -> bool:
    """Whether the policy crashed in every trial before any contact, so that nothing of the contact can be said."""
    return bool(scores) and all(s.crashed_untouched for s in scores)


def failure_modes(scores: Sequence[TrialScore]) -> list[dict[str, Any]]:
    """Return one row per failure mode, most frequent first, with what the failures were attributed to."""
    failed = [s for s in judged(scores) if s.failure_mode is not None]
    counts = Counter(str(s.failure_mode) for s in failed)
    out: list[dict[str, Any]] = []
    for mode, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        causes = Counter(s.attribution or "unattributed" for s in failed if s.failure_mode == mode)
        text = ", ".join(f"{cause} {k}" for cause, k in sorted(causes.items(), key=lambda item: (-item[1], item[0])))
        out.append(
            {"mode": mode.replace("_", " "), "meaning": MODE_MEANING[mode], "count": count, "of": len(failed),
             "attribution": text}
        )  # fmt: skip
    return out


def causes(scores: Sequence[TrialScore]) -> list[Cause]:
    """Return one row per attribution and what happened (``cause_text``), most frequent first."""
    failed: dict[tuple[str, str], list[TrialScore]] = {}
    for score in judged(scores):
        if score.attribution is not None:
            failed.setdefault((score.attribution, cause_text(score)), []).append(score)
    return [
        Cause(name=name, meaning=meaning, count=len(found), examples=_examples(found))
        for (name, meaning), found in sorted(failed.items(), key=lambda item: (-len(item[1]), item[0]))
    ]


def _examples(scores: Sequence[TrialScore]) -> tuple[tuple[str, str], ...]:
    first_of_task = {s.task_id: s.trial_id for s in reversed(scores)}
    told = sorted((s for s in scores if s.evidence), key=lambda s: first_of_task[s.task_id] != s.trial_id)
    return tuple((s.trial_id, evidence_text(s)) for s in told[:EXAMPLES])


def anatomy(scores: Sequence[TrialScore]) -> list[AnatomyRow]:
    """Return one row per region of the tasks, then one over all if there are several."""
    counted = judged(scores)
    regions = list(dict.fromkeys(s.region for s in sorted(counted, key=lambda s: s.task_id)))
    groups = [(region.replace("_", " "), [s for s in counted if s.region == region]) for region in regions]
    if len(groups) > 1:
        groups.append(("all", counted))
    return [_anatomy_row(name, group) for name, group in groups]


def _anatomy_row(name: str, group: Sequence[TrialScore]) -> AnatomyRow:
    count = Counter(s.anatomy for s in group)
    return AnatomyRow(
        region=name,
        n=len(group),
        target=count["target"],
        off_target=count["off_target"],
        none=count["none"],
        process_failure=count["process_failure"],
        success=sum(s.c3_success for s in group),
    )
