"""Straight-line Cartesian motions: legs, and how they become targets at the control rate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import quat_from_matrix
from carecontact.policies.region_geometry import RegionGeometry
from carecontact.policies.state_machine import fixed_values as fixed

F64 = npt.NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Leg:
    """From wherever the last leg ended through ``points``, at rest at both ends."""

    points: F64
    """(n, 3) in base [m]"""
    quat_wxyz: F64
    """(4,) at the end; turned evenly along the way"""
    speed_m_s: float
    hold_s: float = 0.0


def tool_quat(tool_axis: F64, gripper_axis: F64) -> F64:
    """(4,) of a tool whose z is ``tool_axis`` and whose x is ``gripper_axis`` made orthogonal to it."""
    z = tool_axis / np.linalg.norm(tool_axis)
    x = gripper_axis - (gripper_axis @ z) * z
    x /= np.linalg.norm(x)
    return quat_from_matrix(np.stack([x, np.cross(z, x), z], axis=1))


def radial_quat(place: F64) -> F64:
    """Tool straight down, gripper x away from the base's column: the wrist stays near the middle of its range."""
    return tool_quat(-UP, np.array([place[0], place[1], 0.0]))


def touch(geometry: RegionGeometry, *, key_point: float, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Down on the skin, rest, up."""
    skin = geometry.surface((key_point - 0.5) * 2 * geometry.half_length_m)
    quat = radial_quat(geometry.centre_m)
    return [
        _hover(skin, quat),
        _down(skin - depth_m * UP, quat, speed_m_s, hold_s=fixed.TOUCH_DWELL_S),
        _up(skin, quat),
    ]


def scrub(geometry: RegionGeometry, *, key_point: float, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Down in the middle, to one end, back and forth along the axis over the seen surface, up."""
    half = min(fixed.SCRUB_HALF_STROKE_M, geometry.half_length_m - fixed.SCRUB_END_MARGIN_M)
    room = geometry.half_length_m - fixed.SCRUB_END_MARGIN_M - half
    middle = float(np.clip((key_point - 0.5) * 2 * geometry.half_length_m, -room, room))
    steps = int(np.ceil(half / fixed.SCRUB_STEP_M))
    stroke = np.array(
        [geometry.surface(s) - depth_m * UP for s in np.linspace(middle - half, middle + half, 2 * steps + 1)]
    )
    quat = radial_quat(geometry.centre_m)
    hold = fixed.SCRUB_END_DWELL_S
    skin = stroke[steps] + depth_m * UP
    passes = [stroke[steps + 1 :], *([stroke[-2::-1], stroke[1:]] * fixed.SCRUB_PASSES)[: fixed.SCRUB_PASSES]]
    return [
        _hover(skin, quat),
        _down(stroke[steps], quat, fixed.DESCENT_SPEED_M_S, hold_s=hold),
        *(Leg(points=path, quat_wxyz=quat, speed_m_s=speed_m_s, hold_s=hold) for path in passes),
        _up(passes[-1][-1] + depth_m * UP, quat),
    ]


def push(
    geometry: RegionGeometry,
    *,
    key_point: float,
    depth_m: float,
    speed_m_s: float,
    support_height_m: float,
    towards_base: bool,
) -> list[Leg]:
    """Down beside the limb to its middle height, sideways against it and beyond, hold, back, up.

    ``depth_m`` counts from the limb's visible side. Lateral to the limb's axis and level: pressing a limb into its
    support moves nothing.
    """
    skin = geometry.surface((key_point - 0.5) * 2 * geometry.half_length_m)
    side = np.sign(-skin @ geometry.lateral) or 1.0
    outward = geometry.lateral * (side if towards_base else -side)
    tip = support_height_m + max(
        fixed.PUSH_SUPPORT_CLEARANCE_M, 0.5 * (skin[2] - support_height_m) - fixed.CAP_RADIUS_M
    )
    beside = skin + (geometry.radius_m + fixed.CAP_RADIUS_M + fixed.PUSH_STANDOFF_M) * outward
    low = np.array([beside[0], beside[1], tip])
    pushed = low - (fixed.PUSH_STANDOFF_M + depth_m) * outward
    tool_axis = -np.cos(fixed.PUSH_TILT_RAD) * UP - np.sin(fixed.PUSH_TILT_RAD) * outward
    # Of the two ways round, the one that turns the wrist less from its middle.
    reach = np.array([skin[0], skin[1], 0.0])
    quat = tool_quat(tool_axis, outward if outward @ reach > 0 else -outward)
    away = low + fixed.PUSH_BACK_OFF_M * outward
    away_high = away + (skin[2] + fixed.HOVER_M - tip) * UP
    return [
        _hover(beside, quat),
        _down(low, quat, fixed.DESCENT_SPEED_M_S),
        Leg(points=pushed[None], quat_wxyz=quat, speed_m_s=speed_m_s, hold_s=fixed.PUSH_HOLD_S),
        Leg(points=away[None], quat_wxyz=quat, speed_m_s=fixed.NEAR_SPEED_M_S),
        Leg(points=away_high[None], quat_wxyz=quat, speed_m_s=fixed.NEAR_SPEED_M_S),
    ]


def _hover(skin: F64, quat: F64) -> Leg:
    return Leg(points=(skin + fixed.HOVER_M * UP)[None], quat_wxyz=quat, speed_m_s=fixed.FREE_SPEED_M_S)


def _down(place: F64, quat: F64, speed_m_s: float, *, hold_s: float = 0.0) -> Leg:
    return Leg(points=place[None], quat_wxyz=quat, speed_m_s=speed_m_s, hold_s=hold_s)


def _up(skin: F64, quat: F64) -> Leg:
    return Leg(points=(skin + fixed.HOVER_M * UP)[None], quat_wxyz=quat, speed_m_s=fixed.NEAR_SPEED_M_S)


def travel(start_pose: F64, contact: Sequence[Leg], *, travel_height_m: float) -> list[Leg]:
    """Up from ``start_pose`` (7,), level over the first point of ``contact``, then ``contact``, then up again."""
    goal, quat = contact[0].points[0], contact[0].quat_wxyz
    height = max(travel_height_m, float(goal[2]))
    lifted = np.array([*start_pose[:2], max(height, float(start_pose[2]))])
    over = np.array([goal[0], goal[1], height])
    last = contact[-1].points[-1]
    leave = np.array([last[0], last[1], max(height, float(last[2]))])
    speed = fixed.FREE_SPEED_M_S
    return [
        Leg(points=lifted[None], quat_wxyz=start_pose[3:], speed_m_s=speed),
        Leg(points=over[None], quat_wxyz=quat, speed_m_s=speed),
        *contact,
        Leg(points=leave[None], quat_wxyz=contact[-1].quat_wxyz, speed_m_s=speed),
    ]


def sample(legs: Sequence[Leg], start_pose: F64, *, control_hz: float) -> Iterator[F64]:
    """(7,) targets at the control rate, the start itself left out. Speeds never exceed the legs'."""
    position, quat = start_pose[:3], start_pose[3:]
    for leg in legs:
        knots = np.vstack([position, leg.points])
        reach = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
        angle = 2 * np.arccos(np.clip(abs(float(quat @ leg.quat_wxyz)), 0.0, 1.0))
        progress = _progress(float(reach[-1]), float(angle), leg.speed_m_s, control_hz)
        for share in progress:
            yield np.concatenate([_along(knots, reach, share * reach[-1]), slerp(quat, leg.quat_wxyz, share)])
        position, quat = leg.points[-1], leg.quat_wxyz
        for _ in range(round(leg.hold_s * control_hz)):
            yield np.concatenate([position, quat])


def _along(knots: F64, reach: F64, distance: float) -> F64:
    """(3,) point of a polyline at an arc length."""
    k = int(np.clip(np.searchsorted(reach, distance) - 1, 0, len(knots) - 2))
    step = reach[k + 1] - reach[k]
    share = (distance - reach[k]) / step if step > 0 else 1.0
    return knots[k] + share * (knots[k + 1] - knots[k])


def _progress(length: float, angle: float, speed: float, control_hz: float) -> F64:
    """Shares of a leg at each control tick: a trapezoid in speed, stretched so that the last tick is the end."""
    if length < 1e-6 and angle < 1e-6:
        return np.zeros(0)
    # A pure turn is timed as if it were the length that takes as long at this speed.
    effective = max(length, angle / fixed.ROTATION_SPEED_RAD_S * speed)
    cruise = min(speed, float(np.sqrt(effective * fixed.ACCELERATION_M_S2)))
    ramp = cruise / fixed.ACCELERATION_M_S2
    duration = effective / cruise + ramp
    ticks = int(np.ceil(duration * control_hz))
    time = np.linspace(0.0, duration, ticks + 1)[1:]
    tail = np.minimum(ramp, duration - time)
    first = np.minimum(time, ramp)
    distance = 0.5 * fixed.ACCELERATION_M_S2 * first**2 + cruise * np.clip(time - ramp, 0.0, duration - 2 * ramp)
    distance += 0.5 * fixed.ACCELERATION_M_S2 * (ramp**2 - tail**2)
    return distance / distance[-1]


def slerp(a: F64, b: F64, share: float) -> F64:
    """(4,) unit quaternions, the short way."""
    dot = float(a @ b)
    if dot < 0:
        b, dot = -b, -dot
    angle = np.arccos(min(dot, 1.0))
    if angle < 1e-6:
        return b
    return (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle)
