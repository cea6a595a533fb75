"""What a policy may answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

ACTION_SPACES = ("cartesian_pose",)
"""Names that a policy's card may give; ``episode.spaces`` holds the object behind each."""
MAX_CHUNK = 2000
"""Largest number of actions in one answer (a chunk)."""


@dataclass(frozen=True, kw_only=True)
class Action:
    """A target pose of the tool centre point, in the robot's base frame."""

    pose_tcp_in_base: npt.NDArray[np.float64] | None = None
    """(7,) position [m] and quat_wxyz; None keeps the last target."""
    stiffness: tuple[float, float] | None = None
    """(translational [N/m], rotational [N m/rad]); None keeps the last. Out of bounds is an error, never clamped."""
    gripper: float | None = None
    """Opening in [0, 1]; None keeps the last. The closed-gripper embodiment ignores the value, but a value
    outside [0, 1] is still an error."""
    done: bool = False
    """True ends the trial after this action."""
