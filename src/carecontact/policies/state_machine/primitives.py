"""The three contact primitives: touch, scrub and push, each a list of legs at the person."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.policies.motion import (
    CAP_RADIUS_M,
    FREE_SPEED_M_S,
    NEAR_SPEED_M_S,
    TRAVEL_CLEARANCE_M,
    UP,
    Leg,
    radial_quat,
    tool_quat,
)
from carecontact.policies.state_machine import fixed_values as fixed
from carecontact.sight import RegionGeometry

F64 = npt.NDArray[np.float64]


def touch(geometry: RegionGeometry, *, key_point: float, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Move down onto the skin, rest there, and move up.

    Args:
        geometry: the region as it was seen.
        key_point: place along the region, 0 at its proximal end (abdomen: caudal) and 1 at the other end.
        depth_m: how far below the seen skin the tool is commanded [m].
        speed_m_s: speed of the way down.
    """
    skin = geometry.surface((key_point - 0.5) * 2 * geometry.half_length_m)
    quat = radial_quat(geometry.centre_m)
    return [
        _hover(skin, quat),
        _down(skin - depth_m * UP, quat, speed_m_s, hold_s=fixed.TOUCH_DWELL_S),
        _up(skin, quat),
    ]


def scrub(geometry: RegionGeometry, *, key_point: float, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Move down, to one end of the stroke, back and forth along the region's axis over the seen surface, and up.

    Args:
        geometry: the region as it was seen.
        key_point: middle of the stroke along the region, 0 to 1; it is moved inward where the stroke would not fit.
        depth_m: how far below the seen skin the tool is commanded [m].
        speed_m_s: speed of the strokes.
    """
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
    """Move down beside the limb, sideways against it and beyond, hold, back away, and up.

    The push is level and across the limb's axis: pressing a limb into what it lies on moves nothing.

    Args:
        geometry: the limb as it was seen.
        key_point: place along the limb, 0 at its proximal end and 1 at its distal end.
        depth_m: how far past the limb's visible side the tool is commanded [m].
        speed_m_s: speed of the push.
        support_height_m: height in base of what the limb lies on [m].
        towards_base: whether the tool comes from the side that faces the robot's base.
    """
    skin = geometry.surface((key_point - 0.5) * 2 * geometry.half_length_m)
    side = np.sign(-skin @ geometry.lateral) or 1.0
    outward = geometry.lateral * (side if towards_base else -side)
    tip = support_height_m + max(fixed.PUSH_SUPPORT_CLEARANCE_M, 0.5 * (skin[2] - support_height_m) - CAP_RADIUS_M)
    beside = skin + (geometry.radius_m + CAP_RADIUS_M + fixed.PUSH_STANDOFF_M) * outward
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
        Leg(points=away[None], quat_wxyz=quat, speed_m_s=NEAR_SPEED_M_S),
        Leg(points=away_high[None], quat_wxyz=quat, speed_m_s=NEAR_SPEED_M_S),
    ]


def travel_height(person: F64, start_pose: F64, goal: F64) -> float:
    """Return a height in base [m] that clears the person between the parked tool and ``goal`` (3,).

    Args:
        person: (N, 3) points of the person's surface in base [m].
        start_pose: (7,) pose of the parked tool in base.
    """
    start = start_pose[:2]
    way = goal[:2] - start
    offset = person[:, :2] - start
    share = np.clip(offset @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
    near = np.linalg.norm(offset - share[:, None] * way, axis=1) < fixed.TRAVEL_CORRIDOR_M
    top = float(person[near, 2].max()) if near.any() else float(goal[2])
    return top + TRAVEL_CLEARANCE_M


def _hover(skin: F64, quat: F64) -> Leg:
    return Leg(points=(skin + fixed.HOVER_M * UP)[None], quat_wxyz=quat, speed_m_s=FREE_SPEED_M_S)


def _down(place: F64, quat: F64, speed_m_s: float, *, hold_s: float = 0.0) -> Leg:
    return Leg(points=place[None], quat_wxyz=quat, speed_m_s=speed_m_s, hold_s=hold_s)


def _up(skin: F64, quat: F64) -> Leg:
    return Leg(points=(skin + fixed.HOVER_M * UP)[None], quat_wxyz=quat, speed_m_s=NEAR_SPEED_M_S)
