"""How far the person's joints came toward the ends of their range, and beyond."""

from __future__ import annotations

import numpy as np

from carecontact.recording import Recording
from carecontact.scoring.filters import F64

LEAST_SETTLED_RAD = 0.01
"""Settled margins below this count as this value, because a share of almost nothing means nothing. The shipped persons
settle with at least 0.08 rad."""


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


def joints_beyond(recording: Recording, limit_rad: float) -> dict[str, float]:
    """Joint -> how far beyond its range it went [rad], for those that went farther than the limit."""
    if not len(recording["scorer/human_joint_position"]):
        return {}
    beyond = -least_margin(recording)[0]
    return {name: float(b) for name, b in zip(recording.header.human_joints, beyond, strict=True) if b > limit_rad}


def farthest_beyond(recording: Recording) -> tuple[str, float, float]:
    """Return the joint that went farthest beyond its range, by how much [rad], and when [s]."""
    position = recording["scorer/human_joint_position"].astype(np.float64)
    low, high = recording["scorer/human_joint_range"].T
    beyond = np.maximum(low - position, position - high)
    step, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
    return recording.header.human_joints[int(joint)], float(beyond.max()), float(recording["scorer/time_s"][step])


def joints_consumed(recording: Recording, share: float) -> dict[str, float]:
    """Joint -> share of its settled margin that was used up, for those above the given share."""
    if not len(recording["scorer/human_joint_position"]):
        return {}
    consumed = consumed_margin(recording)
    return {name: float(c) for name, c in zip(recording.header.human_joints, consumed, strict=True) if c > share}
