"""Cartesian poses of the tool: their bounds, and the check of each action that arrives from a policy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from carecontact.contract.action.action import Action
from carecontact.contract.action.hints import (
    gripper_hint,
    looks_like_difference,
    looks_like_millimetres,
    pose_shape_hint,
)
from carecontact.errors import ActionError

QUATERNION_NORM_TOLERANCE = 1e-2
"""Largest distance of a quaternion's norm from 1. Within it, the benchmark normalises the quaternion, because
policies compute in single precision or interpolate; beyond it, the action is an error."""


@dataclass(frozen=True, kw_only=True)
class ActionBounds:
    """Limits that a policy learns before its first action."""

    workspace_low_m: tuple[float, float, float]
    workspace_high_m: tuple[float, float, float]
    """Box of TCP positions in base."""
    translational_stiffness: tuple[float, float]
    rotational_stiffness: tuple[float, float]


def check_action(action: Action, bounds: ActionBounds) -> Action:
    """Validate one action that arrives from a policy.

    Returns:
        The action with a unit quaternion and plain Python numbers.

    Raises:
        ActionError: names the field, what was expected and what was got.
    """
    return Action(
        pose_tcp_in_base=None if action.pose_tcp_in_base is None else _pose(action.pose_tcp_in_base, bounds),
        stiffness=None if action.stiffness is None else _stiffness(action.stiffness, bounds),
        gripper=_gripper(action.gripper),
        done=bool(action.done),
    )


def clip_action(action: Action, bounds: ActionBounds) -> Action:
    """Move a finite target position outside the workspace onto its border.

    Returns:
        The same object if there is nothing to move, or if ``check_action`` will refuse the pose anyway.
    """
    pose = None if action.pose_tcp_in_base is None else np.asarray(action.pose_tcp_in_base)
    if pose is None or pose.shape != (7,) or pose.dtype.kind not in "fiu" or not np.isfinite(pose).all():
        return action
    inside = np.clip(pose[:3], bounds.workspace_low_m, bounds.workspace_high_m)
    if (inside == pose[:3]).all():
        return action
    return replace(action, pose_tcp_in_base=np.concatenate([inside, pose[3:]]))


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
    _check_position(pose[:3], bounds)
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        meant = looks_like_difference(pose[:3])
        raise ActionError(
            f"pose_tcp_in_base: expected a quaternion of norm 1, got {norm:.4g}"
            + (f"; the position {_shown(pose[:3])} {meant}" if meant else "")
        )
    pose[3:] /= norm
    # Again, because the first division may leave a norm that differs from 1 in the last digit. The second may too, so
    # that a pose must be checked once only: the last bits depend on how often.
    pose[3:] /= float(np.linalg.norm(pose[3:]))
    return pose


def _check_position(position: npt.NDArray[np.float64], bounds: ActionBounds) -> None:
    low, high = np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m)
    if (position >= low).all() and (position <= high).all():
        return
    workspace = f"{list(bounds.workspace_low_m)} to {list(bounds.workspace_high_m)} m in base"
    if meant := looks_like_difference(position) or looks_like_millimetres(position, low, high):
        raise ActionError(f"pose_tcp_in_base: the position {_shown(position)} {meant}; the workspace is {workspace}")
    raise ActionError(f"pose_tcp_in_base: expected a position inside the workspace {workspace}, got {_shown(position)}")


def _shown(position: npt.NDArray[np.float64]) -> list[float]:
    return [float(f"{x:.6g}") for x in position]


def _stiffness(given: tuple[float, float], bounds: ActionBounds) -> tuple[float, float]:
    if len(given) != 2:
        raise ActionError(f"stiffness: expected (translational, rotational), got {len(given)} numbers")
    limits = (bounds.translational_stiffness, bounds.rotational_stiffness)
    for value, (low, high), unit in zip(given, limits, ("N/m", "N m/rad"), strict=True):
        if not low <= value <= high:
            raise ActionError(f"stiffness: expected {low:g} to {high:g} {unit}, got {value}")
    return float(given[0]), float(given[1])


def _gripper(opening: float | None) -> float | None:
    if opening is not None and not 0 <= opening <= 1:
        raise ActionError(f"gripper: expected an opening in [0, 1], got {opening}{gripper_hint(opening)}")
    return opening
