"""Where a body lies: supports, tilt, and the pose that follows from them."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.world.human.bed_contact import MOST_TILT_DEG, bed_proxies, pelvis_immersion, trunk_tilt
from carecontact.world.human.body import PARENT, Body
from carecontact.world.human.joints import hinges
from carecontact.world.human.pose import (
    BOARD_HEIGHT_M,
    RIGHT_SHOULDER_M,
    SUPINE,
    angle_of_root,
    lying_pose_deg,
    root_position,
    rotation_from_bind,
    trunk_rotation,
)


def bottoms(body: Body, comfort: float = 52.5) -> dict[str, float]:
    """Height of each sphere's lowest point over the mattress in the lying pose, by kinematics written out here."""
    rows, pose = hinges(body), lying_pose_deg(body, comfort)
    turn, place = {"pelvis": trunk_rotation(body)}, {"pelvis": root_position(body, 0.0)}
    for segment in body.segments[1:]:
        parent = PARENT[segment]
        assert parent is not None
        turn[segment] = turn[parent] @ rotation_from_bind(rows, segment, pose)
        place[segment] = place[parent] + turn[parent] @ (body.joint_centre[segment] - body.joint_centre[parent])
    return {
        p.name: place[p.segment][2] + (turn[p.segment] @ (p.centre - body.joint_centre[p.segment]))[2] - p.radius_m
        for p in bed_proxies(body)
    }


def test_trunk_heels_and_arms_touch_what_is_under_them(body: Body) -> None:
    low = bottoms(body)
    for name in ("left_buttock", "right_buttock", "left_scapula", "right_scapula", "left_elbow", "left_wrist"):
        assert low[name] == pytest.approx(0, abs=2e-3), name
    for name in ("right_elbow", "right_wrist"):
        assert low[name] == pytest.approx(BOARD_HEIGHT_M, abs=2e-3), name
    for side in ("left", "right"):
        assert min(low[f"{side}_heel"], low[f"{side}_calf"]) == pytest.approx(0, abs=1e-3)


def test_trunk_lies_about_level_and_the_shoulder_beside_the_board(body: Body) -> None:
    assert np.degrees(trunk_tilt(body)) < MOST_TILT_DEG + 0.2
    assert 0 <= pelvis_immersion(body) < 0.045
    rotation, root = trunk_rotation(body), root_position(body, 0.62)
    shoulder = root + rotation @ (body.joint_centre["right_upper_arm"] - body.joint_centre["pelvis"])
    np.testing.assert_allclose(shoulder[:2], RIGHT_SHOULDER_M, atol=1e-9)
    assert np.degrees(np.arccos((np.trace(rotation @ SUPINE.T) - 1) / 2)) < 3


def test_proxies_lie_inside_the_skin(body: Body) -> None:
    """A sphere that stood out of the body would hold it above the bed."""
    for proxy in bed_proxies(body):
        if proxy.name.endswith(("scapula", "heel", "calf", "occiput")):
            rear = proxy.centre[1] + proxy.radius_m
            near = np.hypot(*(body.vertices - proxy.centre)[:, [0, 2]].T) < 0.05
            assert rear <= body.vertices[near, 1].max() + 1e-6, proxy.name


def test_elbow_is_never_straight(body: Body) -> None:
    low = next(row.range_deg[0] for row in hinges(body) if row.name == "right_forearm_flexion")
    assert lying_pose_deg(body, 52.5)["right_forearm_flexion"] > low + 6


def test_root_is_found_by_bisection() -> None:
    assert angle_of_root(lambda angle: angle**3 - 8, -10, 10) == pytest.approx(2, abs=1e-5)
    assert angle_of_root(lambda angle: angle + 50, -10, 10) == pytest.approx(-10, abs=1e-4)
