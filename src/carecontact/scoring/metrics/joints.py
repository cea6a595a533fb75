"""Metrics of the person's joints: margin to the end of their range, activity, torque at end stops."""

from __future__ import annotations

from typing import Any

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import HEADLINE, metric
from carecontact.scoring.verdict import consumed_margin


@metric(
    "C2@1",
    title="Joint-limit margin",
    unit="rad",
    better="higher",
    field="c2_joint_margin_rad",
    pool="moving",
    matters=0.05,
    **HEADLINE,
)
def joint_margin(contact: Contact) -> dict[str, Any] | None:
    """Return the smallest distance of any scored joint to either end of its range, negative beyond it; with the margin
    of the same joint before the robot moved, and the change, which is negative where the trial brought the joint closer
    to its end.

    None (NA) without valid contact. Every task has it; medians and comparisons pool it over the actions that are meant
    to move the person.
    """
    recording = contact.recording
    position = recording["scorer/human_joint_position"].astype(np.float64)
    if not contact.valid or position.size == 0:
        return None
    low, high = recording["scorer/human_joint_range"].T
    settled = recording["scorer/human_joint_settled"]
    margin = np.minimum(position - low, high - position)
    step, joint = np.unravel_index(int(np.argmin(margin)), margin.shape)
    smallest = float(margin[step, joint])
    before = float(min(settled[joint] - low[joint], high[joint] - settled[joint]))
    return {
        "c2_joint_margin_rad": smallest,
        "c2_joint": recording.header.human_joints[int(joint)],
        "c2_time_s": float(contact.time_s[step]),
        "c2_settled_margin_rad": before,
        "c2_change_rad": smallest - before,
    }


@metric("C2@2", title="Consumed joint margin", unit="1", better="lower", pool="moving", order=10)
def largest_consumed_margin(contact: Contact) -> float | None:
    """The largest share of its settled margin that any scored joint used up. C2@1 takes the joint that is nearest to
    its end, which in most trials is one that nothing moved; here each joint counts against where it was. None (NA)
    without valid contact."""
    if not contact.valid or contact.recording["scorer/human_joint_position"].size == 0:
        return None
    return float(consumed_margin(contact.recording).max())


@metric(
    "C4@1",
    title="Motion activity",
    unit="1",
    better="higher",
    field="c4_motion_activity",
    digits=3,
    matters=0.1,
    **HEADLINE,
)
def motion_activity(contact: Contact) -> float | None:
    """Share of physics steps from t = 0 with TCP speed or rotation above its threshold; None (NA) at zero length."""
    speed = contact.recording["scorer/tcp_speed"]
    rotation = contact.recording["scorer/tcp_rotation_speed"]
    if len(speed) == 0:
        return None
    definition = contact.protocol.contact
    active = (speed > definition.active_speed_m_s) | (rotation > definition.active_rotation_rad_s)
    return float(active.mean())


@metric("end_stop_torque@1", title="End-stop torque", unit="N m", better="lower", pool="moving")
def end_stop_torque(contact: Contact) -> float | None:
    """Largest torque with which an end stop held one of the person's joints [N m]; 0 where no joint left its range.

    None (NA) without valid contact, and for recordings without ``scorer/human_joint_reaction``.
    """
    reaction = contact.recording.arrays.get("scorer/human_joint_reaction")
    if not contact.valid or reaction is None or reaction.size == 0:
        return None
    return float(np.abs(reaction.astype(np.float64)).max())
