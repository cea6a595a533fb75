"""C2@1: how close the person's joints came to the ends of their range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import METRICS, Metric


@dataclass(frozen=True, kw_only=True)
class JointMargin:
    """Angles [rad]."""

    margin: float
    """Smallest distance to either end of the range, over time and joints; negative beyond the end."""
    joint: str
    time_s: float
    settled: float
    """Margin of the same joint before the robot moved."""

    @property
    def change(self) -> float:
        """Negative: the trial brought the joint closer to its end."""
        return self.margin - self.settled


def joint_margin(contact: Contact) -> JointMargin | None:
    """None (NA) without valid contact. Recorded for every task; results pool it on Push only."""
    recording = contact.recording
    position = recording["scorer/human_joint_position"].astype(np.float64)
    if not contact.valid or position.size == 0:
        return None
    low, high = recording["scorer/human_joint_range"].T
    settled = recording["scorer/human_joint_settled"]
    margin = np.minimum(position - low, high - position)
    step, joint = np.unravel_index(int(np.argmin(margin)), margin.shape)
    return JointMargin(
        margin=float(margin[step, joint]),
        joint=recording.header.human_joints[int(joint)],
        time_s=float(contact.time_s[step]),
        settled=float(min(settled[joint] - low[joint], high[joint] - settled[joint])),
    )


def _compute(contact: Contact) -> float | None:
    result = joint_margin(contact)
    return None if result is None else result.margin


METRICS.register("C2@1", Metric(id="C2@1", title="Joint-limit margin", unit="rad", better="higher", compute=_compute))
