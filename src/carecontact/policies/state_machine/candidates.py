"""The options that a language backend chooses from: every primitive, key point, side, depth and speed within reach."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.session import ActionBounds
from carecontact.errors import ContractError
from carecontact.policies.language.backend import Option
from carecontact.policies.motion import Leg, travel
from carecontact.policies.state_machine import fixed_values as fixed
from carecontact.policies.state_machine.primitives import push, scrub, touch
from carecontact.regions import REGIONS
from carecontact.sight import RegionGeometry

F64 = npt.NDArray[np.float64]


class PlanningFailure(ContractError):
    """The state machine has no motion that stays within the arm's reach and the workspace."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An option together with the motion that carries it out."""

    option: Option
    legs: list[Leg]
    """The whole way, from the pose in which the arm is parked until the arm is up again."""

    @property
    def corners_m(self) -> F64:
        """(n, 3) places in base [m] where the tool comes down and where each motion in contact ends."""
        return np.array([leg.points[-1] for leg in self.legs[3:-2]])


def candidates(
    geometry: RegionGeometry, *, start_pose: F64, travel_height_m: float, bounds: ActionBounds | None
) -> list[Candidate]:
    """Return all options that the arm reaches in comfort and whose way stays inside the workspace, in a fixed order.

    Args:
        geometry: the region as it was seen.
        start_pose: (7,) pose of the parked tool in base, position [m] and quat_wxyz.
        travel_height_m: height in base at which the tool moves level over the person [m].
        bounds: the session's limits; None leaves the workspace unlimited.

    Raises:
        PlanningFailure: no option is in reach and inside the workspace.
    """
    found = [
        Candidate(option=option, legs=legs)
        for option, contact in _options(geometry)
        if reachable(contact) and _inside(legs := travel(start_pose, contact, travel_height_m=travel_height_m), bounds)
    ]
    if not found:
        place = np.round(geometry.centre_m, 3).tolist()
        raise PlanningFailure(
            f"the arm cannot reach the {geometry.region.replace('_', ' ')} at {place} m in base without leaving its "
            "comfortable range or the workspace"
        )
    return found


def _options(geometry: RegionGeometry) -> Iterator[tuple[Option, list[Leg]]]:
    for key, depth, speed in product(fixed.TOUCH_KEY_POINTS, fixed.TOUCH_DEPTHS_M, fixed.TOUCH_SPEEDS_M_S):
        option = Option(primitive="touch", approach="above", key_point=key, depth_m=depth, speed_m_s=speed)
        yield option, touch(geometry, key_point=key, depth_m=depth, speed_m_s=speed)
    for key, depth, speed in product(fixed.SCRUB_KEY_POINTS, fixed.SCRUB_DEPTHS_M, fixed.SCRUB_SPEEDS_M_S):
        option = Option(primitive="scrub", approach="above", key_point=key, depth_m=depth, speed_m_s=speed)
        yield option, scrub(geometry, key_point=key, depth_m=depth, speed_m_s=speed)
    support = geometry.support_height_m
    if not REGIONS[geometry.region].sided or support is None:  # the trunk is not pushed aside
        return
    sides = ("near_side", "far_side")
    for side, key, depth, speed in product(
        sides, fixed.PUSH_KEY_POINTS, fixed.PUSH_OVERTRAVEL_M, fixed.PUSH_SPEEDS_M_S
    ):
        option = Option(primitive="push", approach=side, key_point=key, depth_m=depth, speed_m_s=speed)
        legs = push(
            geometry,
            key_point=key,
            depth_m=depth,
            speed_m_s=speed,
            support_height_m=support,
            towards_base=side == "near_side",
        )
        yield option, legs


def reachable(contact: list[Leg]) -> bool:
    """Return whether the elbow is neither folded nor straight at any point of ``contact``.

    The distance from shoulder to wrist decides (SHOULDER_TO_WRIST_M).
    """
    nearest, farthest = fixed.SHOULDER_TO_WRIST_M
    shoulder = np.array([0.0, 0.0, fixed.SHOULDER_HEIGHT_M])
    for leg in contact:
        tool_axis = matrix_from_quat(leg.quat_wxyz)[:, 2]
        outward = leg.points * [1.0, 1.0, 0.0]
        outward -= (outward @ tool_axis)[:, None] * tool_axis
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        wrist = leg.points - fixed.FLANGE_TO_TCP_M * tool_axis - fixed.WRIST_OFFSET_M * outward
        distance = np.linalg.norm(wrist - shoulder, axis=1)
        if distance.min() < nearest or distance.max() > farthest:
            return False
    return True


def _inside(legs: list[Leg], bounds: ActionBounds | None) -> bool:
    if bounds is None:
        return True
    # Straight lines between points of a box stay in the box, so that the points suffice.
    low, high = np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m)
    return all(bool(((leg.points >= low) & (leg.points <= high)).all()) for leg in legs)
