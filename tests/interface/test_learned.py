from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ActionError
from carecontact.interface.deltas import DELTAS
from carecontact.interface.geometry import matrix_from_quat, matrix_from_vector, quat_from_matrix
from carecontact.interface.learned import AGENT_POS, DOWN, MOST, DatasetRows, LearnedActions, rotation_6d, square
from carecontact.interface.observation import Observation
from carecontact.interface.robot import ActionBounds

BOUNDS = ActionBounds(
    workspace_low_m=(0.0, -0.6, 0.0),
    workspace_high_m=(1.0, 0.6, 0.75),
    translational_stiffness=(100.0, 1000.0),
    rotational_stiffness=(5.0, 50.0),
)
POSE = np.array([0.4, 0.1, 0.3, *DOWN])
ROWS = st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7)


def seen(pose: np.ndarray = POSE) -> Observation:
    return Observation(
        instruction="",
        sim_time_s=0.0,
        joint_position=np.arange(7) / 10,
        joint_velocity=-np.arange(7) / 10,
        gripper_position=np.zeros(1),
        pose_tcp_in_base=pose,
    )


def begun(*, absolute: bool = False) -> LearnedActions:
    rows = LearnedActions(BOUNDS, absolute=absolute)
    rows.begin(seen())
    return rows


def test_a_row_of_ones_is_25_mm_and_a_tenth_of_a_radian() -> None:
    rows = begun()
    action = rows.action([1, 0, -1, 0, 0, 1, 0.001])
    assert action.pose_tcp_in_base is not None
    np.testing.assert_allclose(action.pose_tcp_in_base[:3], [0.425, 0.1, 0.275])
    turned = matrix_from_vector(np.array([0, 0, 0.1])) @ matrix_from_quat(DOWN)
    np.testing.assert_allclose(matrix_from_quat(action.pose_tcp_in_base[3:]), turned, atol=1e-12)
    assert action.done
    assert not rows.action([0, 0, 0, 0, 0, 0, 0.0]).done


def test_differences_add_up_from_target_to_target_and_not_from_where_the_tool_is() -> None:
    rows = begun()
    for _ in range(3):
        rows.action([0, 1, 0, 0, 0, 0, -1])
    np.testing.assert_allclose(rows.target[:3], [0.4, 0.175, 0.3])
    behind = rows.agent_pos(seen())[-6:]
    np.testing.assert_allclose(behind, [0, 0.075, 0, 0, 0, 0], atol=1e-7)


@given(st.lists(ROWS, min_size=1, max_size=60))
def test_no_row_leaves_the_workspace_and_numbers_beyond_one_count_as_one(given_rows: list[list[float]]) -> None:
    free, bounded = begun(), begun()
    for row in given_rows:
        one, other = free.action(row), bounded.action(np.clip(row, -1, 1))
        np.testing.assert_array_equal(one.pose_tcp_in_base, other.pose_tcp_in_base)
        assert (free.target[:3] >= BOUNDS.workspace_low_m).all()
        assert (free.target[:3] <= BOUNDS.workspace_high_m).all()
        assert np.linalg.norm(free.target[3:]) == pytest.approx(1.0)


def test_the_rows_are_those_of_the_convention_on_a_card() -> None:
    """A policy may send the same numbers in the action space ``cartesian_delta``."""
    rows, target, rng = begun(), POSE, np.random.default_rng(0)
    for row in rng.uniform(-1, 1, (10, 7)):
        target = DELTAS["learn"].target(row[:6], measured=np.full(7, np.nan), last=target)
        np.testing.assert_array_equal(rows.action(row).pose_tcp_in_base, target)


def test_an_absolute_row_says_where_in_the_workspace_whatever_came_before() -> None:
    rows = begun(absolute=True)
    middle = rows.action(np.zeros(7)).pose_tcp_in_base
    assert middle is not None
    np.testing.assert_allclose(middle, [0.5, 0.0, 0.375, *DOWN])
    rows.action([1, 1, 1, 1, 1, 1, -1])
    corner = rows.action([0.5, -1, 0, 0, 0, -1, -1]).pose_tcp_in_base
    assert corner is not None
    np.testing.assert_allclose(corner[:3], [0.8, -0.6, 0.375])
    quarter = matrix_from_vector(np.array([0, 0, -np.pi / 2])) @ matrix_from_quat(DOWN)
    np.testing.assert_allclose(matrix_from_quat(corner[3:]), quarter, atol=1e-12)


def test_the_numbers_are_the_observation_in_the_named_order() -> None:
    numbers = begun().agent_pos(seen())
    assert numbers.dtype == np.float32
    assert len(numbers) == len(MOST) == sum(AGENT_POS.values())
    position, rotation, joints, velocities, behind = np.split(numbers, np.cumsum(list(AGENT_POS.values()))[:-1])
    np.testing.assert_allclose(position, POSE[:3], rtol=1e-6)
    np.testing.assert_allclose(rotation, [1, 0, 0, 0, -1, 0], atol=1e-7)
    np.testing.assert_allclose(joints, np.arange(7) / 10, rtol=1e-6)
    np.testing.assert_allclose(velocities, -np.arange(7) / 10, rtol=1e-6)
    assert not behind.any()


def test_two_columns_are_a_whole_rotation() -> None:
    matrix = matrix_from_vector(np.array([0.3, -1.1, 0.7]))
    x, y = rotation_6d(matrix).reshape(2, 3)
    np.testing.assert_allclose(np.stack([x, y, np.cross(x, y)], 1), matrix, atol=1e-12)
    np.testing.assert_allclose(quat_from_matrix(matrix), quat_from_matrix(np.stack([x, y, np.cross(x, y)], 1)))


@pytest.mark.parametrize("row", [[0.0] * 6, [[0.0] * 7], [np.nan] + [0.0] * 6, [np.inf] * 7])
def test_what_is_no_row_is_refused(row: list[float]) -> None:
    rows = begun()
    with pytest.raises(ActionError, match=r"^action: expected 7 finite numbers, got \["):
        rows.action(row)
    np.testing.assert_array_equal(rows.target, POSE)


def test_the_middle_of_a_picture_is_averaged() -> None:
    picture = np.zeros((4, 8, 3), np.uint8)
    picture[:, 2:4] = 100  # the left half of the middle square
    picture[:, :2] = picture[:, 6:] = 255
    np.testing.assert_array_equal(square(picture, 2)[..., 0], [[100, 0], [100, 0]])
    picture[:, 4] = 50
    np.testing.assert_array_equal(square(picture, 2)[..., 0], [[100, 25], [100, 25]])


@given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.sampled_from([1.0, -1.0])), min_size=1, max_size=8))
def test_the_state_of_a_dataset_does_not_depend_on_the_signs_of_quaternions(turns: list[tuple[float, float]]) -> None:
    rows, last = DatasetRows(), None
    for number, (turn, sign) in enumerate(turns):
        quat = quat_from_matrix(matrix_from_vector(np.array([turn, 0.0, 0.0])) @ matrix_from_quat(DOWN))
        look = seen(np.concatenate([POSE[:3], sign * quat]))
        if number == 0:
            rows.begin(look)
        state = rows.state(look)
        assert abs(state[3:7] @ quat) == pytest.approx(1.0, abs=1e-6)
        assert state[3:7][np.abs(state[3:7]).argmax()] > 0 if last is None else state[3:7] @ last > 0
        last = state[3:7]


def test_a_row_of_a_dataset_becomes_the_target_behind_which_the_tool_lags() -> None:
    rows = DatasetRows()
    rows.begin(seen())
    action = rows.action([0.4, 0.1, 0.28, 0.0, 2.0, 0.0, 0.0, 1.0])
    assert action.done
    np.testing.assert_allclose(action.pose_tcp_in_base, [0.4, 0.1, 0.28, *DOWN])
    np.testing.assert_allclose(rows.state(seen())[-6:], [0, 0, -0.02, 0, 0, 0], atol=1e-6)
    for wrong in ([0.0] * 7, [0.4, 0.1, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0], [np.nan] * 8):
        with pytest.raises(ActionError, match="expected 8 finite numbers and a rotation"):
            rows.action(wrong)
