"""Part (d) tests whether anything that reaches a policy's process before its first observation reveals the trial."""

from __future__ import annotations

from typing import Any

from carecontact.audit.differences import differences
from carecontact.audit.finding import Finding, Part
from carecontact.audit.schema import failed_at
from carecontact.audit.watched import Watched
from carecontact.hosting.wire.packing import unpack

NAME, TITLE = "handshake", "start, handshake and reset of two different trials"
ONLY = "in trials that differ only in"


def audit_handshake(one: Watched, twin: Watched) -> Part:
    """Compare what reached two policy processes before their first observation.

    ``one`` and ``twin``: witnesses of two trials that differ in seed, id, labels, thresholds and tissue.
    """
    findings = _told_differently(one, twin, "seed, id, labels, thresholds and tissue")
    leaves = len(_leaves(one.told, "")) if twin.told else 0
    return Part(name=NAME, title=TITLE, counts={"facts that reached the process": leaves}, findings=tuple(findings))


def audit_start(one: Watched, other: Watched) -> Part:
    """Compare what two blind witnesses know at t = 0, first observation included: all of it must be the same.

    ``one`` and ``other``: witnesses without a camera, of trials whose seeds lay the person's arm at different angles.
    """
    what = "seed and the angle of the person's arm"
    findings = _told_differently(one, other, what)
    findings += [
        Finding(policy=one.policy, place=place, told=f"could not be started: {trial.error}")
        for trial in (one, other)
        if trial.error
        for place in failed_at(trial.error)
    ]
    starts = False
    if one.looks and other.looks:
        starts = _another_angle(one, other)
        first, second = one.looks[0].sent, other.looks[0].sent
        if first != second:
            told = differences(unpack(first), unpack(second), "message")
            findings += [
                Finding(policy=one.policy, place=place.removeprefix("message."), told=f"at t = 0: {how}, {ONLY} {what}")
                for place, how in told or [("message", "the same values are packed in other bytes")]
            ]
    return Part(
        name=NAME, title=TITLE, counts={"starts with the arm at another angle": int(starts)}, findings=tuple(findings)
    )


def _another_angle(one: Watched, other: Watched) -> bool:
    """Whether the arm lay at different angles in the two trials. A protocol that fixes the angle has nothing to
    hide.
    """
    if one.recording is None or other.recording is None:
        return False
    low, high = one.recording.header.spec.protocol.randomization.comfort_arm_deg
    return low == high or one.recording.header.comfort_arm_deg != other.recording.header.comfort_arm_deg


def _told_differently(one: Watched, other: Watched, what: str) -> list[Finding]:
    findings = [
        Finding(
            policy=one.policy, place=place.removeprefix("told."), told=f"{how}, in trials that differ only in {what}"
        )
        for place, how in differences(one.told, other.told, "told")
    ]
    ids = {t.recording.header.spec.trial_id for t in (one, other) if t.recording is not None}
    return findings + [
        Finding(policy=one.policy, place=place, told=f"contains the trial's id {trial_id}; no policy may receive it")
        for trial in (one, other)
        for place, value in _leaves(trial.told, "")
        for trial_id in sorted(ids)
        if trial_id in str(value)
    ]


def _leaves(value: Any, place: str) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in _leaves(inner, f"{place}.{key}".lstrip("."))]
    if isinstance(value, list):
        return [leaf for index, inner in enumerate(value) for leaf in _leaves(inner, f"{place}[{index}]")]
    return [(place, value)]
