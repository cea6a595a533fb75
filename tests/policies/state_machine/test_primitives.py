from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.observation import Observation
from carecontact.policies.motion import CAP_RADIUS_M, Leg, sample
from carecontact.policies.state_machine import fixed_values as fixed
from carecontact.policies.state_machine.primitives import push, scrub, touch
from carecontact.sight import RegionGeometry, region_from_observation

HZ = 20.0


@pytest.fixture(scope="module")
def forearm(observation: Observation) -> RegionGeometry:
    return region_from_observation(observation, "forearm")


def knots(legs: list[Leg]) -> np.ndarray:
    return np.vstack([leg.points for leg in legs])


def test_touch_goes_straight_down_to_its_depth(forearm: RegionGeometry) -> None:
    legs = touch(forearm, key_point=0.5, depth_m=0.012, speed_m_s=0.03)
    points = knots(legs)
    np.testing.assert_allclose(points[:, :2], np.tile(forearm.centre_m[:2], (3, 1)), atol=1e-3)
    assert points[1, 2] == pytest.approx(forearm.surface(0.0)[2] - 0.012)
    assert legs[1].hold_s >= 1.5
    np.testing.assert_allclose(matrix_from_quat(legs[1].quat_wxyz)[:, 2], [0, 0, -1], atol=1e-9)


def test_key_points_lie_along_the_limb(forearm: RegionGeometry) -> None:
    near, far = (knots(touch(forearm, key_point=k, depth_m=0.012, speed_m_s=0.03))[1] for k in (0.35, 0.65))
    assert (far - near) @ forearm.axis == pytest.approx(0.3 * 2 * forearm.half_length_m, rel=0.02)


def test_scrub_strokes_and_turns(forearm: RegionGeometry) -> None:
    legs = scrub(forearm, key_point=0.5, depth_m=0.015, speed_m_s=0.07)
    start = np.concatenate([legs[0].points[0], legs[0].quat_wxyz])
    poses = np.array(list(sample(legs[1:-1], start, control_hz=HZ)))
    along = (poses[:, :3] - forearm.centre_m) @ forearm.axis
    assert along.min() == pytest.approx(-0.06, abs=0.003)
    assert along.max() == pytest.approx(0.06, abs=0.003)
    moving = np.sign(np.diff(along)[np.abs(np.diff(along)) > 1e-4])
    assert (np.diff(moving) != 0).sum() == fixed.SCRUB_PASSES
    low = poses[np.isclose(poses[:, 2], poses[:, 2].min(), atol=0.01)]
    skin = np.array([forearm.surface(a)[2] for a in (low[:, :3] - forearm.centre_m) @ forearm.axis])
    np.testing.assert_allclose(skin - low[:, 2], 0.015, atol=0.01)


def test_scrub_stays_on_a_short_region(forearm: RegionGeometry) -> None:
    legs = scrub(forearm, key_point=0.9, depth_m=0.015, speed_m_s=0.07)
    along = (knots(legs) - forearm.centre_m) @ forearm.axis
    assert np.abs(along).max() <= forearm.half_length_m


@pytest.mark.parametrize("towards_base", [True, False])
def test_push_is_level_and_across(forearm: RegionGeometry, towards_base: bool) -> None:
    legs = push(forearm, key_point=0.7, depth_m=0.06, speed_m_s=0.05, support_height_m=0.0, towards_base=towards_base)
    _, low, pushed, away, _ = (leg.points[-1] for leg in legs)
    stroke = pushed - low
    assert stroke[2] == 0
    assert abs(stroke @ forearm.axis) < 0.01 * np.linalg.norm(stroke)
    place = forearm.surface(0.4 * forearm.half_length_m)
    start_gap = np.linalg.norm((low - place)[:2]) - forearm.radius_m - CAP_RADIUS_M
    assert start_gap == pytest.approx(fixed.PUSH_STANDOFF_M, abs=1e-6)
    assert np.linalg.norm(stroke) == pytest.approx(fixed.PUSH_STANDOFF_M + 0.06)
    assert (np.linalg.norm(low[:2]) < np.linalg.norm(place[:2])) == towards_base
    # Over the support by the clearance, and not over the limb's middle.
    assert 0.015 <= low[2] <= forearm.centre_m[2] / 2
    assert (away - low) @ stroke < 0
    # The hand leans away from the limb.
    tool_axis = matrix_from_quat(legs[1].quat_wxyz)[:, 2]
    assert tool_axis @ stroke / np.linalg.norm(stroke) == pytest.approx(np.sin(fixed.PUSH_TILT_RAD))
