"""Failures in words: cause, evidence, and what a trial shows of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.runs.pooling import judged
from carecontact.scoring.attribution import BESIDE, NO_MOTION, SOLVER
from carecontact.scoring.behaviour import BEHAVIOURS, behaviour_of, blamed_on
from carecontact.scoring.result import TrialScore

# The evidence that is kept with a score, as pages word it: kept scores never change, so that the words do here.

OFF_SURFACE = re.compile(r"came to (\S+ mm) above the surface of")
"""The distance is to the nearest point of the region's surface, which may lie to the side."""
SHARE_OF = re.compile(r"\b(\d+)% of (\d+)%")
SEGMENT = re.compile(r"\b(?:left|right)(?:_[a-z]+)+\b")


def evidence_text(score: TrialScore) -> str:
    """Return the evidence for a cause; empty without one. What it quotes from the policy, in quotation marks, stays."""
    parts = (score.evidence or "").split('"')
    return '"'.join(_worded(part) if i % 2 == 0 else part for i, part in enumerate(parts))


def off_surface(score: TrialScore) -> bool:
    """Whether the commanded path came near the region and never onto its surface."""
    evidence = score.evidence or ""
    return bool(OFF_SURFACE.search(evidence)) or " off its surface" in evidence


def spaced(text: str) -> str:
    """Percent signs behind a no-break space."""
    return re.sub(r"(?<=\d) ?%", "\N{NO-BREAK SPACE}%", text)


def _worded(text: str) -> str:
    text = OFF_SURFACE.sub(r"came to within \1 of the surface of", text)
    text = SHARE_OF.sub(r"\1% of the time, \2% needed", text)
    return spaced(SEGMENT.sub(lambda found: found[0].replace("_", " "), text))


def cause_text(score: TrialScore) -> str:
    """Return what the policy, the robot or the benchmark did, according to the failure mode and the evidence that is
    kept with the score; empty for a trial without a cause."""
    evidence = score.evidence or ""
    if score.failure_mode == "not_by_tool":
        # The last sentence of the evidence says which part it was.
        return "the region was touched by the robot's hand or links, not by its tool"
    match score.attribution:
        case "planning":
            return _planning(score, evidence)
        case "perception" if evidence.startswith(NO_MOTION):
            return "the region was in view, but was not found, and no motion was commanded"
        case "perception":
            return "the region was in view, but the commanded path was aimed beside it"
        case "execution":
            return _execution(score)
        case "safety" if score.failure_mode == "joint_beyond_range":
            return "a joint of the person was moved too far beyond its range"
        case "safety" if evidence.startswith(SOLVER):
            return "the benchmark stopped the trial, because the solver failed"
        case "safety":
            return "the benchmark stopped the trial, because a force exceeded the truncation limit"
        case "process":
            return "the policy's process, its program or its language backend failed"
        case None:
            return ""


def _planning(score: TrialScore, evidence: str) -> str:
    if evidence.startswith(NO_MOTION):
        return "the policy commanded no motion"
    if BESIDE in evidence.partition(":")[0].partition(";")[0]:
        return "the policy commanded a path beside the named region"
    if score.failure_mode in ("no_target_contact", "off_target_contact"):
        return "the policy commanded a path that stayed off the surface of the named region"
    if score.failure_mode == "lost_contact":
        return "the policy commanded a path that left the skin of the named region"
    if off_surface(score):
        return "the tool touched the person, but the policy commanded a path that stayed off the named region's surface"
    return "the policy commanded a path that reached the named region, but could not pass the gate there"


def _execution(score: TrialScore) -> str:
    if score.failure_mode == "lost_contact":
        return "the commanded path was right, but the contact was lost"
    if score.failure_mode in ("no_target_contact", "off_target_contact"):
        return "the commanded path led onto the named region, but the robot did not get there"
    return "the commanded path asked for enough, but the robot fell short of it"


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


def only_crashes(scores: Sequence[TrialScore]) -> bool:
    """Whether the policy crashed in every trial before any contact, so that nothing is known of a contact."""
    return bool(scores) and all(s.crashed_untouched for s in scores)


def failure_modes(scores: Sequence[TrialScore]) -> list[dict[str, Any]]:
    """Return one row per failure mode, most frequent first, with what the failures were attributed to."""
    failed = [s for s in judged(scores) if s.failure_mode is not None]
    out: list[dict[str, Any]] = []
    for mode, count in _most_first(str(s.failure_mode) for s in failed):
        blamed = _most_first(s.attribution or "unattributed" for s in failed if s.failure_mode == mode)
        text = ", ".join(f"{cause} {k}" for cause, k in blamed)
        out.append(
            {"mode": mode.replace("_", " "), "meaning": MODE_MEANING[mode], "count": count, "of": len(failed),
             "attribution": text}
        )  # fmt: skip
    return out


def _most_first(names: Iterable[str]) -> list[tuple[str, int]]:
    return sorted(Counter(names).items(), key=lambda item: (-item[1], item[0]))


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
    with_evidence = sorted((s for s in scores if s.evidence), key=lambda s: first_of_task[s.task_id] != s.trial_id)
    return tuple((s.trial_id, evidence_text(s)) for s in with_evidence[:EXAMPLES])


ANATOMY = ("target", "off_target", "none", "process_failure")


def anatomy(scores: Sequence[TrialScore]) -> list[dict[str, Any]]:
    """Return counts per region of the tasks, then over all if there are several; those of ANATOMY add up to ``n``."""
    counted = judged(scores)
    regions = list(dict.fromkeys(s.region for s in sorted(counted, key=lambda s: s.task_id)))
    groups = [(region.replace("_", " "), [s for s in counted if s.region == region]) for region in regions]
    if len(groups) > 1:
        groups.append(("all", counted))
    return [
        {"region": name, "n": len(group), "success": sum(s.c3_success for s in group)}
        | {kind: sum(s.anatomy == kind for s in group) for kind in ANATOMY}
        for name, group in groups
    ]


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
