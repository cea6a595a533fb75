"""Where a body lies: supports, tilt, and the pose that follows from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.human.body import PARENT, Body
from carecontact.human.joints import hinges
from carecontact.human.library import load_body
from carecontact.human.pose import (
    BOARD_HEIGHT_M,
    HALF_SCRUB_M,
    MOST_TILT_DEG,
    RIGHT_SHOULDER_M,
    SUPINE,
    angle_of_root,
    bed_proxies,
    crowded_until,
    free_middle,
    lying_pose_deg,
    pelvis_immersion,
    root_position,
    rotation_from_bind,
    trunk_rotation,
    trunk_tilt,
)
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.subject import scripted_along_m
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.world.scene import Scene, build_scene


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


ARM = "right_upper_arm"


def scene_of(body: str) -> Scene:
    return build_scene(overridden(load_protocol("bathing-v3"), {"person.body": body}), target=None, skin=False)


def test_the_chests_of_heavy_bodies_crowd_the_arm_and_that_of_man_adult_does_not() -> None:
    shares = {name: crowded_until(load_body(f"{name}"), ARM) for name in ("man-adult", "man-adult-heavy")}
    assert shares["man-adult"] < 0.45 < 0.5 < shares["man-adult-heavy"]
    assert free_middle(load_body("man-adult"), ARM) == 0.5
    body = load_body("man-adult-heavy")
    length = np.linalg.norm(body.axis_vector(ARM))
    assert free_middle(body, ARM) == pytest.approx(shares["man-adult-heavy"] + HALF_SCRUB_M / length)


def test_a_wider_and_higher_chest_crowds_more_of_the_arm() -> None:
    body = load_body("man-adult")
    chest = body.owner == body.segments.index("thorax")
    higher = replace(body, vertices=body.vertices + np.where(chest[:, None], [-0.05, -0.06, 0.0], 0.0))
    assert crowded_until(higher, ARM) > crowded_until(body, ARM) + 0.1


def test_the_region_of_a_crowded_arm_lies_nearer_the_elbow_and_stays_soft_up_to_the_armpit() -> None:
    plain, heavy = scene_of("man-adult"), scene_of("woman-old-heavy")
    lengths = {}
    for scene in (plain, heavy):
        frame, shell = scene.frames["upper_arm"], scene.regions["upper_arm"].shell
        whole = float(np.linalg.norm(scene.body.axis_vector(ARM)))
        start = (frame.origin - scene.body.joint_centre[ARM]) @ scene.body.direction(ARM)
        assert start == pytest.approx(whole - frame.size_m[0] / 2), "it ends at the elbow"
        lengths[scene.body.name] = frame.size_m[0] / whole
        soft = (shell.vertices - scene.body.joint_centre[ARM]) @ scene.body.direction(ARM) / whole
        assert soft.min() == pytest.approx(0.25, abs=0.01)
        cells = (scene.regions["upper_arm"].cells.centres - frame.origin) @ frame.axes[:, 0]
        assert np.abs(cells).max() < frame.size_m[0] / 2 + 0.01, "cells are of the region"
    assert lengths["man-adult"] == pytest.approx(1.0)
    assert lengths["woman-old-heavy"] < 0.5
    assert scripted_along_m(plain, "upper_arm") == REGIONS["upper_arm"].scripted_along_m
    assert scripted_along_m(heavy, "upper_arm") == 0.0
