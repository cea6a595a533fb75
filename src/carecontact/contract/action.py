"""What a policy may answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError

ACTION_SPACES = ("cartesian_pose",)
MAX_CHUNK = 2000


@dataclass(frozen=True, kw_only=True)
class Action:
    """A target pose of the tool centre point, in the robot's base frame."""

    pose_tcp_in_base: npt.NDArray[np.float64] | None = None
    """(7,) position [m] and quat_wxyz; None keeps the last target."""
    stiffness: tuple[float, float] | None = None
    """(translational [N/m], rotational [N m/rad]); None keeps the last. Out of bounds is an error, never clamped."""
    gripper: float | None = None
    """Opening in [0, 1]; None keeps the last. Ignored by the closed-gripper embodiment, but not unchecked."""
    done: bool = False
    """True ends the trial after this action."""


@dataclass(frozen=True, kw_only=True)
class ActionBounds:
    """Published in the handshake."""

    workspace_low_m: tuple[float, float, float]
    workspace_high_m: tuple[float, float, float]
    """Box of TCP positions in base."""
    translational_stiffness: tuple[float, float]
    rotational_stiffness: tuple[float, float]


def check_action(action: Action, bounds: ActionBounds) -> Action:
    """Validate one action at the border; returns it with a unit quaternion.

    Raises ActionError naming the field, what was expected and what was got.
    """
    pose = action.pose_tcp_in_base
    if pose is not None:
        pose = np.asarray(pose)
        if pose.shape != (7,) or pose.dtype.kind not in "fiu":
            raise ActionError(
                "pose_tcp_in_base: expected 7 numbers (x y z [m], quaternion w x y z), "
                f"got shape {pose.shape} {pose.dtype}"
            )
        pose = pose.astype(np.float64)
        if not np.isfinite(pose).all():
            raise ActionError(f"pose_tcp_in_base: expected finite numbers, got {pose.tolist()}")
        low, high = np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m)
        if (pose[:3] < low).any() or (pose[:3] > high).any():
            raise ActionError(
                f"pose_tcp_in_base: expected a position inside the workspace {list(bounds.workspace_low_m)} to "
                f"{list(bounds.workspace_high_m)} m in base, got {[float(f'{x:.6g}') for x in pose[:3]]}"
            )
        with np.errstate(over="ignore"):
            norm = float(np.linalg.norm(pose[3:]))
        if abs(norm - 1.0) > 1e-2:
            raise ActionError(f"pose_tcp_in_base: expected a quaternion of norm 1, got {norm:.4g}")
        pose[3:] /= norm
    stiffness = action.stiffness
    if stiffness is not None:
        if len(stiffness) != 2:
            raise ActionError(f"stiffness: expected (translational, rotational), got {len(stiffness)} numbers")
        limits = (bounds.translational_stiffness, bounds.rotational_stiffness)
        for value, (low_k, high_k), unit in zip(stiffness, limits, ("N/m", "N m/rad"), strict=True):
            if not low_k <= value <= high_k:
                raise ActionError(f"stiffness: expected {low_k:g} to {high_k:g} {unit}, got {value}")
        stiffness = (float(stiffness[0]), float(stiffness[1]))
    gripper = action.gripper
    if gripper is not None and not 0 <= gripper <= 1:
        raise ActionError(f"gripper: expected an opening in [0, 1], got {gripper}")
    return Action(pose_tcp_in_base=pose, stiffness=stiffness, gripper=gripper, done=bool(action.done))
