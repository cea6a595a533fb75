"""Part (d): does anything that reaches a policy's process before its first observation know which trial it is?"""

from __future__ import annotations

from typing import Any

from carecontact.audit.differences import differences
from carecontact.audit.finding import Finding, Part
from carecontact.audit.watched import Watched

NAME, TITLE = "handshake", "start, handshake and reset of two different trials"


def audit_handshake(one: Watched, twin: Watched) -> Part:
    """``one`` and ``twin``: witnesses of trials with another seed, id, labels, thresholds and tissue."""
    findings = [
        Finding(policy=one.policy, place=place.removeprefix("told."), told=f"{what}, in trials that differ only in "
                "seed, id, labels, thresholds and tissue")
        for place, what in differences(one.told, twin.told, "told")
    ]  # fmt: skip
    ids = {t.recording.header.spec.trial_id for t in (one, twin) if t.recording is not None}
    findings += [
        Finding(policy=one.policy, place=place, told=f"holds the trial's id {trial_id}")
        for trial in (one, twin)
        for place, value in _leaves(trial.told, "")
        for trial_id in sorted(ids)
        if trial_id in str(value)
    ]
    leaves = len(_leaves(one.told, "")) if twin.told else 0
    return Part(name=NAME, title=TITLE, counts={"facts that reached the process": leaves}, findings=tuple(findings))


def _leaves(value: Any, place: str) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in _leaves(inner, f"{place}.{key}".lstrip("."))]
    if isinstance(value, list):
        return [leaf for index, inner in enumerate(value) for leaf in _leaves(inner, f"{place}[{index}]")]
    return [(place, value)]
