"""What a policy may answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

MAX_CHUNK = 2000
"""Largest number of actions in one answer (a chunk)."""


@dataclass(frozen=True, kw_only=True)
class Action:
    """One action of a chunk. The action space on the policy's card says which fields it may give."""

    pose_tcp_in_base: npt.NDArray[np.float64] | None = None
    """(7,) target of the tool centre point in the robot's base frame, position [m] and quat_wxyz; None keeps the last
    target."""
    stiffness: tuple[float, ...] | None = None
    """(translational [N/m], rotational [N m/rad]), or six numbers: x y z [N/m], then about x y z [N m/rad], along the
    axes of the target. None keeps the last. Out of bounds is an error, never clamped."""
    damping_ratio: float | None = None
    """Damping of every axis as a share of critical damping; None keeps the last, which is 1 at first."""
    wrench_in_tcp: npt.NDArray[np.float64] | None = None
    """(6,) feedforward in the axes of the tool, force [N] and torque [N m], that the robot adds to the spring's wrench
    and exerts on what it touches; None keeps the last, which is zero at first."""
    joint: npt.NDArray[np.float64] | None = None
    """(joints,) for the joint action spaces: angles [rad] or normalised velocities; None keeps the last target."""
    gripper: float | None = None
    """Opening in [0, 1]; None keeps the last. The closed-gripper embodiment ignores the value, but a value
    outside [0, 1] is still an error."""
    done: bool = False
    """True ends the trial after this action."""
