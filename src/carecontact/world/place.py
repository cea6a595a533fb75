"""Place of the person on the bed, which a seed draws and which is set in a compiled model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

import mujoco
import numpy as np

from carecontact.contract.protocol import Variation
from carecontact.world.furniture import SUPPORT
from carecontact.world.human.pose import RIGHT_SHOULDER_M
from carecontact.world.human.skeleton import ROOT_JOINT

SHOULDER = np.array([*RIGHT_SHOULDER_M, 0.0])
"""(3,) place on the floor under the right shoulder of a person in the protocol's own place [m]."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Change of the protocol's own place: first a turn about the vertical through the right shoulder, then a shift.

    The turn is about the shoulder because it lies beside the robot: a turn about a farther point would move the arm
    more.
    """

    along_m: float = 0.0
    """Shift along the bed, towards the head."""
    across_m: float = 0.0
    """Shift to the person's right, which is towards the robot."""
    yaw_deg: float = 0.0
    """Turn, counter-clockwise when seen from above."""

    @property
    def shift(self) -> np.ndarray:
        """(3,) shift in the world [m]."""
        return np.array([self.along_m, self.across_m, 0.0])

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Return where points (..., 3) of a person in the protocol's own place are in this place."""
        cos, sin = np.cos(radians(self.yaw_deg)), np.sin(radians(self.yaw_deg))
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return SHOULDER + self.shift + (points - SHOULDER) @ turn.T


UNMOVED = Place()


def draw_place(rng: np.random.Generator, variation: Variation) -> Place:
    """Draw each value uniformly between plus and minus the protocol's value.

    Each value has a draw of its own, which is a share of its range, so that seeds keep their order in a narrower
    range.
    """
    return place_of(rng.uniform(-1.0, 1.0, 3).tolist(), variation)


def place_of(shares: Sequence[float], variation: Variation) -> Place:
    """Return the place for three shares of the ranges, from -1 to 1: along, across and yaw."""
    along, across, yaw = shares
    up = variation.place_toward_head_m
    farthest = variation.place_along_m if up is None or along < 0 else min(up, variation.place_along_m)
    return Place(
        along_m=along * farthest,
        across_m=across * variation.place_across_m,
        yaw_deg=yaw * variation.place_yaw_deg,
    )


def move_person(model: mujoco.MjModel, place: Place) -> None:
    """Move the person, the pillow and the arm board in a compiled model; bed, robot and cameras stay where they are.

    Call it once, before the person settles: it changes where a reset puts the person.
    """
    turn, at, shift = np.zeros(4), SHOULDER, place.shift
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), radians(place.yaw_deg))

    def moved(position: np.ndarray, quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset, turned = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(offset, np.asarray(position, np.float64) - at, turn)
        mujoco.mju_mulQuat(turned, turn, np.asarray(quat, np.float64))
        return at + offset + shift, turned

    support = model.body(SUPPORT)
    support.pos[:], support.quat[:] = moved(support.pos, support.quat)
    start = model.joint(ROOT_JOINT).qposadr[0]
    root = model.qpos0[start : start + 7]
    root[:3], root[3:] = moved(root[:3].copy(), root[3:].copy())


def place_in_model(model: mujoco.MjModel) -> list[float]:
    """Return 14 numbers: the pose of the person at a reset, and that of pillow and board. ``move_person`` changes these
    and nothing else in a compiled model.
    """
    start, support = model.joint(ROOT_JOINT).qposadr[0], model.body(SUPPORT)
    return [*model.qpos0[start : start + 7].tolist(), *support.pos.tolist(), *support.quat.tolist()]
