"""Hints about refused actions: what their numbers look like, and what to send instead. A hint is empty if the numbers
resemble no known mistake."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

NEAR_BASE_M = 0.12
"""The robot's base stands there: no tool can be so near, but every difference of two poses is."""


def pose_shape_hint(shape: tuple[int, ...]) -> str:
    """Return a clause, with its semicolon, about numbers of a shape other than (7,) in place of one pose."""
    if shape == (6,):
        return "; six numbers look like x y z and roll pitch yaw: turn the angles into a quaternion w x y z"
    if shape == (3,):
        return "; three numbers look like a position: add the quaternion w x y z"
    if shape == (8,):
        return "; eight numbers look like a pose and a gripper: give the last one as gripper"
    if shape == (1, 7):
        return "; this looks like a pose in a list of its own: leave the outer list out"
    if len(shape) == 2 and shape[1] == 7:
        return f"; these look like {shape[0]} poses: send a list with one action for each"
    return ""


def looks_like_difference(position: npt.NDArray[np.float64]) -> str:
    """Return what is said of a position (3,) [m] that is too near the robot's base to be a target."""
    if math.hypot(*position) >= NEAR_BASE_M:
        return ""
    return "looks like a difference to the tool's pose: send the absolute pose of the tool in base"


def looks_like_millimetres(
    position: npt.NDArray[np.float64], low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]
) -> str:
    """Return what is said of a position (3,) that lies in the workspace if its numbers are millimetres. The corners of
    the workspace in base are ``low`` and ``high`` (3,) [m]."""
    metres = position / 1000.0
    if looks_like_difference(metres) or (metres < low).any() or (metres > high).any():
        return ""
    return "looks like millimetres: send metres"


def gripper_hint(opening: float) -> str:
    """Return a clause, with its semicolon, about an opening outside [0, 1]."""
    said = "; 1 is open and 0 is closed"
    if -1 <= opening < 0:
        return f"{said}: of a range from -1 to 1 send (1 + g) / 2, or (1 - g) / 2 where -1 means open"
    return said
