"""Straight-line Cartesian motions that policies share: legs, the way over the person, and targets at a control rate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.interface.action import Action
from carecontact.interface.geometry import quat_from_matrix
from carecontact.interface.robot import PANDA

F64 = npt.NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])

CONTROL_HZ = 20.0
"""Rate of the targets [Hz] in a policy that sends a whole motion as one chunk."""
FREE_SPEED_M_S = 0.25
"""Tool speed away from the person: the speed limit of the session's target interpolation."""
NEAR_SPEED_M_S = 0.10
"""Tool speed close to the skin."""
ACCELERATION_M_S2 = 0.5
ROTATION_SPEED_RAD_S = 0.8
"""Below the session's limit of 1.0 rad/s."""
TRAVEL_CLEARANCE_M = 0.12
"""Height over the highest point of the person under the way: room for the hand's half width of 0.1 m when it is
tilted."""
CAP_RADIUS_M = PANDA.tool_radius_m
"""Radius of the rounded fingertip cap."""


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A motion from wherever the last leg ended through ``points``; the tool is at rest at both ends."""

    points: F64
    """(n, 3) positions of the tool centre point in base [m]."""
    quat_wxyz: F64
    """(4,) orientation at the end of the leg. The tool turns evenly along the way."""
    speed_m_s: float
    hold_s: float = 0.0
    """How long the tool stays at the last point [s]."""

    @classmethod
    def to(cls, place: F64, quat_wxyz: F64, speed_m_s: float, *, hold_s: float = 0.0) -> Leg:
        """Return the straight way to one place (3,)."""
        return cls(points=place[None], quat_wxyz=quat_wxyz, speed_m_s=speed_m_s, hold_s=hold_s)


def tool_quat(tool_axis: F64, gripper_axis: F64) -> F64:
    """Return the (4,) wxyz orientation of a tool whose z points along ``tool_axis`` (3,).

    The tool's x points along ``gripper_axis`` (3,) as far as it can while being orthogonal to z. Neither vector needs
    to have length 1, but they must not be parallel.
    """
    z = tool_axis / np.linalg.norm(tool_axis)
    x = gripper_axis - (gripper_axis @ z) * z
    x /= np.linalg.norm(x)
    return quat_from_matrix(np.stack([x, np.cross(z, x), z], axis=1))


def radial_quat(place: F64) -> F64:
    """Return the (4,) wxyz orientation of a tool that points straight down at ``place`` (3,) in base [m].

    The gripper's x points away from the base's column, so that the wrist stays near the middle of its range.
    """
    return tool_quat(-UP, np.array([place[0], place[1], 0.0]))


def travel(start_pose: F64, contact: Sequence[Leg], *, travel_height_m: float) -> list[Leg]:
    """Return the legs of a whole way: up from the start, level to ``contact``, through it, and up again.

    Args:
        start_pose: (7,) pose of the tool in base, position [m] and quat_wxyz.
        contact: the legs at the person; the first one ends where the level way ends.
        travel_height_m: height in base at which the tool moves level.
    """
    goal, quat = contact[0].points[0], contact[0].quat_wxyz
    height = max(travel_height_m, float(goal[2]))
    lifted = np.array([*start_pose[:2], max(height, float(start_pose[2]))])
    over = np.array([goal[0], goal[1], height])
    last = contact[-1].points[-1]
    leave = np.array([last[0], last[1], max(height, float(last[2]))])
    return [
        Leg.to(lifted, start_pose[3:], FREE_SPEED_M_S),
        Leg.to(over, quat, FREE_SPEED_M_S),
        *contact,
        Leg.to(leave, contact[-1].quat_wxyz, FREE_SPEED_M_S),
    ]


def chunk(legs: Sequence[Leg], start_pose: F64) -> list[Action]:
    """Return the whole way from ``start_pose`` (7,) as one chunk of actions, of which the last ends the trial."""
    poses = list(sample(legs, start_pose))
    return [Action(pose_tcp_in_base=pose, done=k == len(poses) - 1) for k, pose in enumerate(poses)]


def sample(legs: Sequence[Leg], start_pose: F64) -> Iterator[F64]:
    """Yield (7,) target poses at CONTROL_HZ, from the first one after ``start_pose`` (7,) to the last.

    No two neighbouring targets are farther apart than a leg's speed allows.
    """
    position, quat = start_pose[:3], start_pose[3:]
    for leg in legs:
        knots = np.vstack([position, leg.points])
        reach = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
        angle = 2 * np.arccos(np.clip(abs(float(quat @ leg.quat_wxyz)), 0.0, 1.0))
        for share in _progress(float(reach[-1]), float(angle), leg.speed_m_s):
            yield np.concatenate([_along(knots, reach, share * reach[-1]), slerp(quat, leg.quat_wxyz, share)])
        position, quat = leg.points[-1], leg.quat_wxyz
        for _ in range(round(leg.hold_s * CONTROL_HZ)):
            yield np.concatenate([position, quat])


def slerp(a: F64, b: F64, share: float) -> F64:
    """Return the (4,) unit quaternion at ``share`` (0 to 1) of the shorter turn from ``a`` (4,) to ``b`` (4,)."""
    dot = float(a @ b)
    if dot < 0:
        b, dot = -b, -dot
    angle = np.arccos(min(dot, 1.0))
    if angle < 1e-6:
        return b
    return (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle)


def _along(knots: F64, reach: F64, distance: float) -> F64:
    """Return the (3,) point at an arc length [m] of a polyline with corners ``knots`` (n, 3)."""
    k = int(np.clip(np.searchsorted(reach, distance) - 1, 0, len(knots) - 2))
    step = reach[k + 1] - reach[k]
    share = (distance - reach[k]) / step if step > 0 else 1.0
    return knots[k] + share * (knots[k + 1] - knots[k])


def _progress(length: float, angle: float, speed: float) -> F64:
    """Return the share of a leg that is done at each control tick.

    The speed follows a trapezoid over time, stretched so that the last tick falls on the end of the leg.
    """
    if length < 1e-6 and angle < 1e-6:
        return np.zeros(0)
    # A pure turn is timed as if it were the length that takes as long at this speed.
    effective = max(length, angle / ROTATION_SPEED_RAD_S * speed)
    cruise = min(speed, float(np.sqrt(effective * ACCELERATION_M_S2)))
    ramp = cruise / ACCELERATION_M_S2
    duration = effective / cruise + ramp
    ticks = int(np.ceil(duration * CONTROL_HZ))
    time = np.linspace(0.0, duration, ticks + 1)[1:]
    tail = np.minimum(ramp, duration - time)
    first = np.minimum(time, ramp)
    distance = 0.5 * ACCELERATION_M_S2 * first**2 + cruise * np.clip(time - ramp, 0.0, duration - 2 * ramp)
    distance += 0.5 * ACCELERATION_M_S2 * (ramp**2 - tail**2)
    return distance / distance[-1]
