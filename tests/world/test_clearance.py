"""Where a chest is in the way of the hand, and where the upper arm's region lies because of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.protocols import load_protocol, overridden
from carecontact.regions import REGIONS
from carecontact.validation.moves import scripted_along_m
from carecontact.world.human.clearance import HALF_SCRUB_M, crowded_until, free_middle
from carecontact.world.human.library import load_body
from carecontact.world.scene import Scene, build_scene

ARM = "right_upper_arm"


def scene_of(body: str) -> Scene:
    return build_scene(overridden(load_protocol(), {"person.body": body}), target=None, skin=False)


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
