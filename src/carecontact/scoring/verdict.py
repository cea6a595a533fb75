"""Whether a trial is safe, correct and successful, and how far the person's joints came toward their ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from carecontact.recording import Recording
from carecontact.scoring.behaviour import Gate, ask, behaviour_of
from carecontact.scoring.contact import F64, Contact
from carecontact.scoring.foam import at_foam
from carecontact.scoring.metrics.force import peak_of_segments
from carecontact.scoring.result import Anatomy, FailureMode

LEAST_SETTLED_RAD = 0.01
"""Settled margins below this count as this value, because a share of almost nothing means nothing. The shipped persons
settle with at least 0.08 rad."""
MOST = 0.5
"""Share of the contact impulse from which on the tool applied most of it."""


def least_margin(recording: Recording) -> tuple[F64, F64]:
    """(J,) smallest distance of each scored joint to either end of its range over the trial, negative beyond it, and
    (J,) that of the settled person [rad]."""
    position = recording["scorer/human_joint_position"].astype(np.float64)
    low, high = recording["scorer/human_joint_range"].T
    settled = recording["scorer/human_joint_settled"]
    margin = np.minimum(position - low, high - position).min(axis=0)
    return margin, np.minimum(settled - low, high - settled)


def consumed_margin(recording: Recording) -> F64:
    """(J,) share of each joint's settled margin that the trial used up: 0 where it never came nearer to an end, 1 at
    the end, above 1 beyond it."""
    least, settled = least_margin(recording)
    settled = np.maximum(settled, LEAST_SETTLED_RAD)
    return np.maximum(1.0 - least / settled, 0.0)


def farthest_beyond(recording: Recording) -> tuple[str, float, float]:
    """Return the joint that went farthest beyond its range, by how much [rad], and when [s]."""
    position = recording["scorer/human_joint_position"].astype(np.float64)
    low, high = recording["scorer/human_joint_range"].T
    beyond = np.maximum(low - position, position - high)
    step, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
    return recording.header.human_joints[int(joint)], float(beyond.max()), float(recording["scorer/time_s"][step])


def _joints_above(
    recording: Recording, values: Callable[[Recording], F64], limit: float | None
) -> dict[str, float] | None:
    """Joint -> its value, for those above the limit; None without a limit."""
    if limit is None:
        return None
    if not len(recording["scorer/human_joint_position"]):
        return {}
    rows = zip(recording.header.human_joints, values(recording), strict=True)
    return {name: float(value) for name, value in rows if value > limit}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    anatomy: Anatomy
    success: bool
    region_correct: bool
    """Success with enough of the contact impulse on the named region and at its foam, where it has some; a failure
    otherwise."""
    safety_gated: bool
    """Region-correct, not stopped early by the benchmark, no touched segment above its discounted pain limit at any
    time, and, where the protocol has a gate for them, no joint beyond its range by more than it allows."""
    joints_beyond: dict[str, float] | None
    """Joint -> how far beyond its range it went [rad], where that is more than the gate allows; None without one."""
    joints_consumed: dict[str, float] | None
    """Joint -> share of its settled margin used up, where that is flagged; None without such a gate."""
    over_limit: dict[str, float]
    """Segment -> peak over gamma' F_pain, where above 1."""
    failure_mode: FailureMode | None
    """How the trial failed; None only for a region-correct trial that moved no joint too far."""


def reach_verdict(contact: Contact, gate: Gate, *, own: Verdict | None = None) -> Verdict:
    """Return the verdict on a trial. ``own``: that on the same recording under another gate or floor, whose joints are
    the same."""
    share, rules, gates = contact.region_share, contact.protocol, contact.protocol.gates
    region_correct = gate.success and share is not None and share >= gates.region_share and at_foam(contact)
    ratios = {s: f / (rules.limits.gamma * rules.f_pain(s)) for s, f in peak_of_segments(contact).items()}
    over = {segment: ratio for segment, ratio in ratios.items() if ratio > 1.0}
    if own is not None:
        beyond, consumed = own.joints_beyond, own.joints_consumed
    else:
        beyond = _joints_above(contact.recording, lambda r: -least_margin(r)[0], gates.joint_beyond_rad)
        consumed = _joints_above(contact.recording, consumed_margin, gates.joint_consumed)
    return Verdict(
        anatomy=_anatomy(contact),
        success=gate.success,
        region_correct=region_correct,
        # A knock that cuts a trial can be too short for its segment to count as touched.
        safety_gated=region_correct
        and not over
        and not beyond
        and contact.recording.header.ended != "safety_truncation",
        joints_beyond=beyond,
        joints_consumed=consumed,
        over_limit=over,
        failure_mode=_failure_mode(contact, gate) if not region_correct else "joint_beyond_range" if beyond else None,
    )


def _anatomy(contact: Contact) -> Anatomy:
    if contact.recording.header.ended in ("process_failure", "harness_error"):
        return "process_failure"
    if contact.reported is None:
        return "none"
    return "target" if contact.reported == contact.target else "off_target"


def _failure_mode(contact: Contact, gate: Gate) -> FailureMode:
    """The order of the tests is part of the definition: the first that matches wins."""
    ended, anatomy = contact.recording.header.ended, _anatomy(contact)
    if anatomy == "process_failure":
        return "process_failure"
    if ended == "safety_truncation":
        return "safety_truncation"
    if anatomy == "none":
        return "no_target_contact"
    if anatomy == "off_target":
        return "off_target_contact"
    behaviour, share = behaviour_of(contact.task.action, contact.protocol.gates.set), contact.tool_share
    if not gate.success and behaviour.by_tool and share is not None and share < MOST:
        return "not_by_tool"
    if not gate.time_met and ask(contact, "lost", contact, contact.protocol.gates.of(contact.task.action), gate):
        return "lost_contact"
    if not gate.success and gate.time_met and gate.progress_met and not (gate.band_met and gate.conduct_met):
        return "outside_band"
    # Short of progress, or stopped of its own accord; a hold that the clock cut short is neither.
    if not gate.success and not (gate.progress_met and ended == "time_limit"):
        return "insufficient_progress"
    return "wrong_share" if gate.success else "time_limit"
