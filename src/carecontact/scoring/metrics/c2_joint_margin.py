"""C2@1: how close the person's joints came to the ends of their range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


@dataclass(frozen=True, kw_only=True)
class JointMargin:
    """The smallest margin of any scored joint, and where and when it was."""

    c2_joint_margin_rad: float
    """Smallest distance to either end of the range, over time and joints; negative beyond the end."""
    c2_joint: str
    c2_time_s: float
    c2_settled_margin_rad: float
    """Margin of the same joint before the robot moved."""
    c2_change_rad: float
    """Negative: the trial brought the joint closer to its end."""


@metric(
    "C2@1", title="Joint-limit margin", unit="rad", better="higher", field="c2_joint_margin_rad", pool="moving",
    headline=True, matters=0.05, order=0,
)  # fmt: skip
def joint_margin(contact: Contact) -> JointMargin | None:
    """Return the smallest margin; None (NA) without valid contact. Every task has it; medians and comparisons pool it
    over the actions that are meant to move the person."""
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
    return JointMargin(
        c2_joint_margin_rad=smallest,
        c2_joint=recording.header.human_joints[int(joint)],
        c2_time_s=float(contact.time_s[step]),
        c2_settled_margin_rad=before,
        c2_change_rad=smallest - before,
    )
