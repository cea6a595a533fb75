"""The action spaces that a card can name, as rows of ACTION_SPACES: fields, bounds and check of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError
from carecontact.interface.action import (
    ACTION_SPACES,
    Action,
    ActionSpace,
    check_gripper,
    looks_like_difference,
    looks_like_millimetres,
    pose_shape_hint,
)
from carecontact.interface.robot import ActionBounds, Session

QUATERNION_NORM_TOLERANCE = 1e-2
"""Largest distance of a quaternion's norm from 1. Within it, the benchmark normalises the quaternion, because
policies compute in single precision or interpolate; beyond it, the action is an error."""
MAX_FEEDFORWARD_N, MAX_FEEDFORWARD_NM = 40.0, 5.0
"""Largest component of a feedforward force and torque (chosen). 40 N is the contact force at which DROID's Panda stops
by default (collision_behavior in its config/panda/franka_hardware.yaml)."""
DAMPING_RATIO = (0.3, 2.0)
"""Smallest and largest damping ratio (chosen): below, a soft contact rings on; above, the arm creeps."""


def check_action(action: Action, bounds: ActionBounds) -> Action:
    """Check one action with a pose that arrives from a policy; return it with a unit quaternion and plain Python
    numbers. Raises ActionError naming the field, what was expected and what was got.
    """
    return Action(
        pose_tcp_in_base=None if action.pose_tcp_in_base is None else _pose(action.pose_tcp_in_base, bounds),
        delta=None if action.delta is None else _delta(action.delta),
        stiffness=None if action.stiffness is None else _stiffness(action.stiffness, bounds),
        damping_ratio=None if action.damping_ratio is None else _damping_ratio(action.damping_ratio),
        wrench_in_tcp=None if action.wrench_in_tcp is None else _wrench(action.wrench_in_tcp),
        gripper=check_gripper(action.gripper),
        done=bool(action.done),
    )


def clip_action(action: Action, bounds: ActionBounds) -> Action:
    """Move a finite target position outside the workspace onto its border; return the same object if there is nothing
    to move, or if ``check_action`` will refuse the pose anyway.
    """
    pose = None if action.pose_tcp_in_base is None else np.asarray(action.pose_tcp_in_base)
    if pose is None or pose.shape != (7,) or pose.dtype.kind not in "fiu" or not np.isfinite(pose).all():
        return action
    inside = np.clip(pose[:3], bounds.workspace_low_m, bounds.workspace_high_m)
    same = (inside == pose[:3]).all()
    return action if same else replace(action, pose_tcp_in_base=np.concatenate([inside, pose[3:]]))


def _pose(given: npt.NDArray[np.float64], bounds: ActionBounds) -> npt.NDArray[np.float64]:
    pose = np.asarray(given)
    if pose.shape != (7,) or pose.dtype.kind not in "fiu":
        raise ActionError(
            f"pose_tcp_in_base: expected 7 numbers (x y z [m], quaternion w x y z), got shape {pose.shape} {pose.dtype}"
            f"{pose_shape_hint(pose.shape)}"
        )
    pose = pose.astype(np.float64)
    if not np.isfinite(pose).all():
        raise ActionError(f"pose_tcp_in_base: expected finite numbers, got {pose.tolist()}")
    position = [float(f"{x:.6g}") for x in pose[:3]]
    low, high = np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m)
    difference = looks_like_difference(pose[:3])
    if not ((pose[:3] >= low).all() and (pose[:3] <= high).all()):
        workspace = f"{list(bounds.workspace_low_m)} to {list(bounds.workspace_high_m)} m in base"
        if meant := difference or looks_like_millimetres(pose[:3], low, high):
            raise ActionError(f"pose_tcp_in_base: the position {position} {meant}; the workspace is {workspace}")
        raise ActionError(f"pose_tcp_in_base: expected a position inside the workspace {workspace}, got {position}")
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        hint = f"; the position {position} {difference}" if difference else ""
        raise ActionError(f"pose_tcp_in_base: expected a quaternion of norm 1, got {norm:.4g}{hint}")
    pose[3:] /= norm
    # Again, because the first division may leave a norm that differs from 1 in the last digit. The second may too, so
    # that a pose must be checked once only: the last bits depend on how often.
    pose[3:] /= float(np.linalg.norm(pose[3:]))
    return pose


def _delta(given: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    delta = np.asarray(given)
    if delta.shape != (6,) or delta.dtype.kind not in "fiu":
        hint = {
            (7,): "; seven numbers look like a delta and a gripper: give the last one as gripper, an opening in [0, 1]",
            (3,): "; three numbers look like a translation: add the three of the rotation",
        }.get(delta.shape, "")
        raise ActionError(
            f"delta: expected 6 numbers (translation, rotation), got shape {delta.shape} {delta.dtype}{hint}"
        )
    delta = delta.astype(np.float64)
    if not np.isfinite(delta).all():
        raise ActionError(f"delta: expected finite numbers, got {delta.tolist()}")
    return delta


def allowed_stiffness(values: npt.NDArray[np.float64], bounds: ActionBounds) -> npt.NDArray[np.bool_]:
    """Return which of the numbers (..., 2), translational and rotational, or (..., 6), one for each axis, are allowed.
    Zero is, for a single axis: there, a feedforward alone moves the tool."""
    limits = np.array([bounds.translational_stiffness, bounds.rotational_stiffness], np.float64)
    low, high = limits.repeat(values.shape[-1] // 2, axis=0).T
    return ((low <= values) & (values <= high)) | ((values == 0) & (values.shape[-1] == 6))


def _stiffness(given: tuple[float, ...], bounds: ActionBounds) -> tuple[float, ...]:
    """Two numbers, or one for each axis."""
    if np.ndim(given) != 1 or len(given) not in (2, 6):
        raise ActionError(
            "stiffness: expected 2 numbers (translational, rotational) or 6 (x y z, then about x y z), "
            f"got {len(given) if np.ndim(given) else given}"
        )
    allowed = allowed_stiffness(np.array(given, np.float64), bounds)
    if not allowed.all():
        axis = int(np.flatnonzero(~allowed)[0])
        (low, high), unit = bounds.translational_stiffness, "N/m"
        if axis >= len(given) // 2:
            (low, high), unit = bounds.rotational_stiffness, "N m/rad"
        zero = ", or 0 on an axis with a feedforward" if len(given) == 6 else ""
        raise ActionError(f"stiffness: expected {low:g} to {high:g} {unit}{zero}, got {given[axis]}")
    return tuple(float(value) for value in given)


def _damping_ratio(given: float) -> float:
    low, high = DAMPING_RATIO
    if not low <= given <= high:
        raise ActionError(f"damping_ratio: expected {low:g} to {high:g} (1 is critical damping), got {given}")
    return float(given)


def _wrench(given: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    wrench = np.asarray(given)
    expected = (
        f"expected 6 numbers in the axes of the tool, a force of at most {MAX_FEEDFORWARD_N:g} N and a torque of at "
        f"most {MAX_FEEDFORWARD_NM:g} N m in each"
    )
    if wrench.shape != (6,) or wrench.dtype.kind not in "fiu":
        raise ActionError(f"wrench_in_tcp: {expected}, got shape {wrench.shape} {wrench.dtype}")
    wrench = wrench.astype(np.float64)
    # Written so that NaN is refused.
    if not (np.abs(wrench) <= [MAX_FEEDFORWARD_N] * 3 + [MAX_FEEDFORWARD_NM] * 3).all():
        raise ActionError(f"wrench_in_tcp: {expected}, got {wrench.tolist()}")
    return wrench


ACTION_SPACES.register(
    "cartesian_pose",
    ActionSpace(
        description=(
            "Targets of the tool's pose for the Cartesian impedance controller; optionally its stiffness, its damping "
            "and a feedforward wrench."
        ),
        fields=("pose_tcp_in_base", "stiffness", "damping_ratio", "wrench_in_tcp"),
        in_joints=False,
        checked=lambda action, session: check_action(action, session.action_bounds),
        clipped=lambda action, session: clip_action(action, session.action_bounds),
    ),
)


ACTION_SPACES.register(
    "cartesian_delta",
    ActionSpace(
        description=(
            "Differences of the tool's pose in the convention that the card names as `delta`; optionally stiffness, "
            "damping and a feedforward wrench."
        ),
        fields=("delta", "stiffness", "damping_ratio", "wrench_in_tcp"),
        in_joints=False,
        checked=lambda action, session: check_action(action, session.action_bounds),
        clipped=lambda action, session: action,
    ),
)
"""Bounds and border depend on the convention and on where the tool is: the driver knows them."""


def joints_of(action: Action, session: Session, unit: str) -> npt.NDArray[np.float64]:
    """Return the numbers (joints,) of an action that gives ``joint``. Raises ActionError, which names the ``unit``, for
    another shape or type, or a NaN.
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
        first = outside[0]
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
    ),
)


def _check_velocity(action: Action, session: Session) -> Action:
    joint = None if action.joint is None else joints_of(action, session, "1 is 0.2 rad in one control period")
    return Action(joint=joint, gripper=check_gripper(action.gripper), done=bool(action.done))


ACTION_SPACES.register(
    "droid_joint_velocity",
    ActionSpace(
        description=(
            "Seven normalised joint velocities. At each action the target becomes the measured angles plus 0.2 rad "
            "times the velocities, scaled down if one exceeds 1, and is held until the next action."
        ),
        fields=("joint",),
        in_joints=True,
        checked=_check_velocity,
        clipped=lambda action, session: action,
    ),
)
