from __future__ import annotations

import numpy as np
import pytest

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import ValueMap
from carecontact.policies.voxposer.planner import Plan, plan

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


def test_the_scene_is_an_obstacle_but_near_tool_and_target() -> None:
    scene = EMPTY.copy()
    scene[:, :, 30] = True
    made = plan((50, 50, 80), target(50, 50, 30), NOTHING, scene)
    assert made.avoidance[50, 50, 30] == 0
    assert made.avoidance[50, 50 + fixed.FREE_RADIUS_VOXELS - 1, 30] == 0
    assert made.avoidance[50, 50 + fixed.FREE_RADIUS_VOXELS + 1, 30] == 1
    np.testing.assert_allclose(made.waypoints[-1], [50, 50, 30])


def test_a_path_that_ends_far_from_the_target_does_not_jump_to_it() -> None:
    shell = NOTHING.copy()
    shell[30:71, 30:71, 30:71] = 1
    made = plan((5, 5, 5), target(50, 50, 50), shell, EMPTY)
    if made.distance[tuple(made.waypoints[-1].astype(int))] > 0:
        assert np.linalg.norm(made.waypoints[-1] - made.waypoints[-2]) < fixed.SNAP_VOXELS
    assert np.isfinite(made.waypoints).all()


def test_on_the_target_already() -> None:
    np.testing.assert_allclose(plan((50, 50, 50), target(50, 50, 50), NOTHING, EMPTY).waypoints, [[50, 50, 50]])


def test_an_empty_target_is_an_error() -> None:
    with pytest.raises(ValueError, match="empty"):
        plan((1, 1, 1), NOTHING, NOTHING, EMPTY)


def test_a_map_is_what_was_written_last(grid: Grid) -> None:
    made = ValueMap(kind="velocity")
    made.add((50, 50, 50), (0.5,), radius_cm=10)
    made.add((50, 50, 50), (0.2,), radius_cm=3)
    made.add((99, 0, 0), (0.7,), radius_cm=5)
    dense = made.dense(grid)
    centre = grid.points(np.array([50.0, 50, 50]))
    for offset, value in ((0.0, 0.2), (0.025, 0.2), (0.05, 0.5), (0.099, 0.5), (0.12, None)):
        place = centre + [0, 0, offset]
        assert (made.at(grid, place) or (None,))[0] == value
        if abs(offset / grid.pitch_m[2] - round(offset / grid.pitch_m[2])) < 0.01:
            assert dense[grid.voxel(place)] == pytest.approx(value or 0)
    assert dense[99, 0, 0] == pytest.approx(0.7)
    volume = (dense > 0.15).sum() * grid.pitch_m.prod()
    assert volume == pytest.approx(4 / 3 * np.pi * (0.10**3 + 0.05**3 / 8), rel=0.1)


def test_voxels_and_points(grid: Grid) -> None:
    point = np.array([0.4, 0.1, 0.2])
    assert np.abs(grid.points(np.array(grid.voxel(point), float)) - point).max() <= grid.pitch_m.max() / 2
    assert grid.voxel(np.array([-5.0, 0.0, 9.0])) == (0, 50, 99)
    assert grid.contains(np.array([[0.5, 0, 0.1], [0.5, 0.7, 0.1]])).tolist() == [True, False]
