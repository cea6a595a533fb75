"""Where the trunk obstructs a robot's hand that comes straight down on an arm."""

from __future__ import annotations

import numpy as np

from carecontact.world.human.body import CHILD_ALONG, Array, Body
from carecontact.world.human.joints import hinges
from carecontact.world.human.pose import MIDDLE_ARM_DEG, lying_pose_deg, segment_pose, trunk_rotation

HAND_REACH_M, HAND_OVER_TIP_M = 0.10, 0.035
"""Dimensions of the robot's hand, whichever way it is turned: half its width, and the height of its underside over the
tip of the tool when the tip is 5 mm deep in the skin."""
TOP_M = 0.02
"""The top of the arm at a place is the highest skin within this distance of it."""
HALF_SCRUB_M = 0.025
"""Half of the 50 mm along the region that the protocols' scrub has to cover."""
SHARES = np.linspace(0.2, 0.95, 76)
"""Places that are tried, as shares of the arm's length."""


def free_middle(body: Body, segment: str) -> float:
    """Return the share of a limb's length at which the middle of a region beside the trunk lies.

    It is half. If the chest would obstruct a hand there, it is moved toward the next joint until half a scrub toward
    the trunk is free.
    """
    length = float(np.linalg.norm(body.axis_vector(segment)))
    return max(0.5, crowded_until(body, segment) + HALF_SCRUB_M / length)


def crowded_until(body: Body, segment: str) -> float:
    """Return the largest share of an arm's length at which chest or shoulder would touch the hand; 0 if there is none.

    There, skin within reach of the hand is higher than the hand's underside. The person lies with the comfort arm at
    the middle of its range.
    """
    side, _, name = segment.partition("_")
    rows, pose, trunk = hinges(body), lying_pose_deg(body, MIDDLE_ARM_DEG), trunk_rotation(body)

    def lying(on: str, points: Array) -> Array:
        turn, place = segment_pose(body, rows, pose, trunk, on)
        return place + (points - body.joint_centre[on]) @ turn.T

    chest = lying("thorax", body.vertices_of("thorax", f"{side}_clavicle"))
    arm = lying(segment, body.vertices_of(segment, f"{side}_{CHILD_ALONG[name]}"))
    start = lying(segment, body.joint_centre[segment][None])[0]
    along = lying(segment, (body.joint_centre[segment] + body.axis_vector(segment))[None])[0] - start
    for share in SHARES[::-1]:
        at = (start + share * along)[:2]
        top = arm[np.hypot(*(arm[:, :2] - at).T) < TOP_M, 2].max(initial=-np.inf)
        beside = chest[np.hypot(*(chest[:, :2] - at).T) < HAND_REACH_M, 2].max(initial=-np.inf)
        if np.isfinite(top) and beside - top > HAND_OVER_TIP_M:
            return float(share)
    return 0.0
