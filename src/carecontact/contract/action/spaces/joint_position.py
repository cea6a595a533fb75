"""Absolute targets of the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.contract.action.action import Action
from carecontact.contract.action.space import ACTION_SPACES, ActionSpace, check_gripper
from carecontact.contract.session import Session
from carecontact.errors import ActionError


def joints_of(action: Action, session: Session, unit: str) -> npt.NDArray[np.float64]:
    """Return the numbers (joints,) of an action that gives ``joint``. Raises ActionError for another shape or type, or
    a NaN.

    Args:
        unit: of the numbers, for the message.
    """
    joint, count = np.asarray(action.joint), len(session.joint_low_rad)
    if joint.shape != (count,) or joint.dtype.kind not in "fiu":
        raise ActionError(f"joint: expected {count} numbers [{unit}], got shape {joint.shape} {joint.dtype}")
    joint = joint.astype(np.float64)
    if not np.isfinite(joint).all():
        raise ActionError(f"joint: expected finite numbers [{unit}], got {joint.tolist()}")
    return joint


def _check(action: Action, session: Session) -> Action:
    gripper, done = check_gripper(action.gripper), bool(action.done)
    if action.joint is None:
        return Action(gripper=gripper, done=done)
    joint = joints_of(action, session, "rad")
    low, high = np.array(session.joint_low_rad), np.array(session.joint_high_rad)
    outside = np.flatnonzero((joint < low) | (joint > high))
    if len(outside):
        first = int(outside[0])
        degrees = "; the numbers look like degrees" if np.abs(joint).max() > 2 * np.pi else ""
        raise ActionError(
            f"joint: expected {low[first]:g} to {high[first]:g} rad for joint {first + 1}, "
            f"got {joint[first]:.6g}{degrees}"
        )
    return Action(joint=joint, gripper=gripper, done=done)


def _clip(action: Action, session: Session) -> Action:
    joint = None if action.joint is None else np.asarray(action.joint)
    low, high = session.joint_low_rad, session.joint_high_rad
    if joint is None or joint.shape != (len(low),) or joint.dtype.kind not in "fiu" or not np.isfinite(joint).all():
        return action
    inside = np.clip(joint, low, high)
    return action if (inside == joint).all() else replace(action, joint=inside)


ACTION_SPACES.register(
    "joint_position",
    ActionSpace(
        description="Absolute targets of all joints [rad]; each is held until the next action.",
        fields=("joint",),
        in_joints=True,
        checked=_check,
        clipped=_clip,
        driver="carecontact.episode.drivers.joint:JointPosition",
    ),
)
