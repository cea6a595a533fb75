from __future__ import annotations

import numpy as np
import pytest

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.executor import forward_only, motion
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import ValueMap

TOOL = np.array([0.5, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0])


def run(grid: Grid, *goals: tuple[float, float, float], **maps: ValueMap):
    return motion(np.array(goals), TOOL, grid=grid, maps=maps)


def positions(moved) -> np.ndarray:
    return np.array([a.pose_tcp_in_base[:3] for a in moved.actions])


def test_goes_through_the_waypoints_at_full_speed_and_settles(grid: Grid) -> None:
    moved = run(grid, (0.5, 0.0, 0.2), (0.6, 0.0, 0.2))
    assert moved.whole
    way = positions(moved)
    np.testing.assert_allclose(way[-1], [0.6, 0, 0.2])
    speed = np.linalg.norm(np.diff(np.vstack([TOOL[:3], way]), axis=0), axis=1) * fixed.CONTROL_HZ
    assert speed.max() == pytest.approx(fixed.FULL_SPEED_M_S, rel=0.02)
    assert (speed[-8:] == 0).all()
    assert np.abs(way - [0.5, 0, 0.2]).sum(axis=1).min() < 1e-9


def test_the_end_of_a_path_is_held_for_as_long_as_is_asked(grid: Grid) -> None:
    goal = np.array([[0.5, 0.0, 0.28]])
    short, long = (motion(goal, TOOL, grid=grid, maps={}, settle_s=s) for s in (0.4, 1.0))
    assert len(long.actions) - len(short.actions) == round(0.6 * fixed.CONTROL_HZ)
    assert len(motion(goal, TOOL, grid=grid, maps={}).actions) == len(short.actions)


def test_stops_at_the_horizon(grid: Grid) -> None:
    moved = run(grid, (0.5, 0.5, 0.3), (0.5, 0.55, 0.3))
    assert not moved.whole
    assert len(moved.actions) == round(fixed.HORIZON_S * fixed.CONTROL_HZ)
    assert positions(moved)[-1, 1] < 0.4


def test_the_maps_set_speed_turn_and_gripper(grid: Grid) -> None:
    velocity, rotation, gripper = (ValueMap(kind=k) for k in ("velocity", "rotation", "gripper"))
    near = grid.voxel(np.array([0.5, 0.0, 0.2]))
    turned = (0.0, np.cos(0.2), np.sin(0.2), 0.0)
    velocity.add(near, (0.5,), radius_cm=5)
    rotation.add(near, turned, radius_cm=5)
    gripper.add(near, (1.0,), radius_cm=5)
    moved = run(grid, (0.5, 0.0, 0.25), (0.5, 0.0, 0.2), velocity=velocity, rotation=rotation, gripper=gripper)
    np.testing.assert_allclose(moved.actions[-1].pose_tcp_in_base[3:], turned, atol=1e-9)
    assert moved.actions[0].gripper in (None, 1.0)
    steps = np.linalg.norm(np.diff(positions(moved), axis=0), axis=1) * fixed.CONTROL_HZ
    assert steps[12] == pytest.approx(0.5 * fixed.FULL_SPEED_M_S, rel=0.05)


def test_a_velocity_of_nothing_still_arrives(grid: Grid) -> None:
    still = ValueMap(kind="velocity")
    still.add((50, 50, 40), (0.0,), radius_cm=100)
    first = positions(run(grid, (0.5, 0.0, 0.2), velocity=still))[0]
    assert 0.3 - first[2] == pytest.approx(fixed.MIN_VELOCITY * fixed.FULL_SPEED_M_S / fixed.CONTROL_HZ, rel=0.05)


def test_waypoints_that_lead_back_are_skipped() -> None:
    way = np.array([[0.6, 0, 0], [0.4, 0, 0], [0.7, 0, 0], [0.3, 0, 0], [0.65, 0, 0], [1.0, 0, 0]])
    kept = forward_only(way, np.array([0.5, 0, 0]))
    assert kept[:, 0].tolist() == [0.6, 0.7, 1.0], "seen from the one gone to before"
    back = np.array([[0.4, 0, 0], [1.0, 0, 0]])
    assert forward_only(back, np.array([0.5, 0, 0]))[:, 0].tolist() == [1.0]


def test_near_the_end_the_tool_goes_straight_to_it() -> None:
    way = np.array([[0.9, 0, 0], [0.992, 0.05, 0], [1.0, 0, 0]])
    assert len(forward_only(way, np.array([0.5, 0, 0]))) == 3
    assert forward_only(way, np.array([0.991, 0, 0]))[:, 0].tolist() == [1.0]


def test_many_short_stretches_take_no_longer_than_one(grid: Grid) -> None:
    """A waypoint does not wait for the next tick."""
    one = run(grid, (0.5, 0.0, 0.1))
    many = run(grid, *[(0.5, 0.0, 0.3 - 0.2 * k / 37) for k in range(1, 38)])
    np.testing.assert_allclose(positions(many), positions(one), atol=1e-9)


def test_no_target_leaves_the_workspace(grid: Grid) -> None:
    outside = np.concatenate([[1.2, 0.7, -0.1], TOOL[3:]])
    moved = motion(np.array([[0.99, 0.5, 0.1]]), outside, grid=grid, maps={})
    way = positions(moved)
    assert (way >= grid.low_m).all()
    assert (way <= grid.high_m).all()
