from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import Grid, ValueMap
from carecontact.policies.voxposer.planner import Plan, forward_only, motion, plan

SHAPE = (fixed.MAP_SIZE,) * 3
NOTHING = np.zeros(SHAPE, np.float32)
EMPTY = np.zeros(SHAPE, bool)


def target(*voxel: int) -> np.ndarray:
    out = NOTHING.copy()
    out[voxel] = 1
    return out


def length(start: tuple[int, ...], made: Plan) -> float:
    return float(np.linalg.norm(np.diff(np.vstack([start, made.waypoints]), axis=0), axis=1).sum())


@pytest.fixture(scope="module")
def free() -> Plan:
    return plan((10, 10, 10), target(70, 50, 30), NOTHING, EMPTY)


def test_a_free_way_goes_straight_to_the_target(free: Plan) -> None:
    np.testing.assert_allclose(free.waypoints[-1], [70, 50, 30])
    assert length((10, 10, 10), free) < 1.15 * np.linalg.norm([60, 40, 20])
    assert (np.diff(np.linalg.norm(free.waypoints - [70, 50, 30], axis=1)) < 0).all()


def test_costs_are_normalised_and_lowest_at_the_target(free: Plan) -> None:
    assert (free.cost.min(), free.cost.max()) == (0, 1)
    assert free.cost[70, 50, 30] == 0
    assert free.distance[70, 50, 30] == 0
    assert free.distance[70, 50, 33] == 3


def test_what_is_written_as_avoided_is_gone_round() -> None:
    start, goal = (10, 50, 50), target(90, 50, 50)
    straight = plan(start, goal, NOTHING, EMPTY)
    wall = NOTHING.copy()
    wall[45:55, 30:60, 40:60] = 1
    round_it = plan(start, goal, wall, EMPTY)
    np.testing.assert_allclose(round_it.waypoints[-1], [90, 50, 50])
    inside = round_it.waypoints.astype(int)
    assert wall[tuple(inside.T)].sum() < wall[tuple(straight.waypoints.astype(int).T)].sum()
    assert length(start, round_it) > length(start, straight) + 3
    assert np.abs(round_it.waypoints[:, 1] - 50).max() > 3


RELEASE = json.loads((Path(__file__).parent / "release_paths.json").read_text())["cases"]


@pytest.mark.parametrize("case", RELEASE, ids=lambda case: case["name"])
def test_paths_are_those_of_the_published_release(case: dict[str, Any]) -> None:
    goal, avoided, occupied = NOTHING.copy(), NOTHING.copy(), EMPTY.copy()
    for voxel in case["targets"]:
        goal[tuple(voxel)] = 1
    for low, high, value in case["avoided"]:
        avoided[tuple(map(slice, low, high))] = value
    for low, high in case["occupied"]:
        occupied[tuple(map(slice, low, high))] = True
    made = plan(tuple(case["start"]), goal, avoided, occupied)
    np.testing.assert_allclose(made.waypoints, case["waypoints"], atol=0.002)


def test_the_scene_is_an_obstacle_but_near_tool_and_target() -> None:
    scene = EMPTY.copy()
    scene[:, :, 30] = True
    scene[:, 50, 80] = True
    made = plan((50, 50, 80), target(50, 50, 30), NOTHING, scene)
    assert made.avoidance[50, 50, 30] == 0
    assert made.avoidance[50, 50 + fixed.TARGET_FREE_VOXELS - 1, 30] == 0
    assert made.avoidance[50, 50 + fixed.TARGET_FREE_VOXELS, 30] == 1
    free = made.avoidance[:, 50, 80] == 0
    assert np.flatnonzero(free).tolist() == list(range(50 - fixed.START_FREE_VOXELS, 50 + fixed.START_FREE_VOXELS))
    np.testing.assert_allclose(made.waypoints[-1], [50, 50, 30])


def test_a_walk_that_is_kept_out_is_cut_and_then_goes_straight_to_the_target() -> None:
    shell = NOTHING.copy()
    shell[30:71, 30:71, 30:71] = 1
    made = plan((15, 15, 15), target(50, 50, 50), shell, EMPTY)
    np.testing.assert_allclose(made.waypoints[-1], [50, 50, 50])
    assert np.linalg.norm(made.waypoints[-1] - made.waypoints[-2]) > 20
    assert len(made.waypoints) < fixed.MAX_STEPS / 3, "cut where it began to circle"


def test_on_the_target_already(grid: Grid) -> None:
    """The walk has to leave it; the executor goes straight to the end."""
    made = plan((50, 50, 50), target(50, 50, 50), NOTHING, EMPTY)
    np.testing.assert_allclose(made.waypoints[-1], [50, 50, 50])
    here = grid.points(np.array([50.0, 50, 50]))
    np.testing.assert_allclose(forward_only(grid.points(made.waypoints), here), [here])


def test_at_the_border_the_walk_stays_inside() -> None:
    made = plan((0, 99, 0), target(0, 99, 40), NOTHING, EMPTY)
    np.testing.assert_allclose(made.waypoints[-1], [0, 99, 40])
    assert made.waypoints.min() >= 0
    assert made.waypoints.max() <= 99


def test_only_a_full_value_is_a_target() -> None:
    graded = target(60, 60, 60)
    graded[20, 20, 20] = 0.9
    made = plan((22, 22, 22), graded, NOTHING, EMPTY)
    assert made.distance[20, 20, 20] > 60
    np.testing.assert_allclose(made.waypoints[-1], [60, 60, 60])


def test_a_map_is_what_was_written_last(grid: Grid) -> None:
    made = ValueMap(kind="velocity")
    made.add((50, 50, 50), (0.5,), radius_cm=10)
    made.add((50, 50, 50), (0.2,), radius_cm=3)
    made.add((99, 0, 0), (0.7,), radius_cm=5)
    dense = made.dense(grid)
    # 10 cm are 10, 8 and 13 whole voxels along the axes, 3 cm are 3, 2 and 4.
    for (x, y, z), value in {
        (50, 50, 50): 0.2, (53, 52, 54): 0.2, (54, 50, 50): 0.5, (50, 53, 50): 0.5, (50, 50, 55): 0.5,
        (60, 58, 63): 0.5, (61, 50, 50): None, (50, 59, 50): None, (50, 50, 64): None, (94, 4, 6): 0.7,
    }.items():  # fmt: skip
        assert (made.at(grid, grid.points(np.array([x, y, z], float))) or (None,))[0] == value
        assert dense[x, y, z] == pytest.approx(value or 0)
    assert (dense > 0.45).sum() == 21 * 17 * 27 - 7 * 5 * 9 + 6 * 5 * 7


def test_centimetres_are_whole_voxels_towards_zero(grid: Grid) -> None:
    assert grid.whole_voxels(0.02).tolist() == [2, 1, 2]
    assert grid.whole_voxels(np.array([-0.05, 0.05, -0.001])).tolist() == [-5, 4, 0]


def test_voxels_and_points(grid: Grid) -> None:
    point = np.array([0.4, 0.1, 0.2])
    assert np.abs(grid.points(np.array(grid.voxel(point), float)) - point).max() <= grid.pitch_m.max() / 2
    assert grid.voxel(np.array([-5.0, 0.0, 9.0])) == (0, 50, 99)
    assert grid.contains(np.array([[0.5, 0, 0.1], [0.5, 0.7, 0.1]])).tolist() == [True, False]


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
