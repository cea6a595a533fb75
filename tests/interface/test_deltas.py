"""Deltas against scipy's rotations, robosuite's own lines and Bridge's, and back again."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from carecontact.errors import ActionError, ContractError
from carecontact.interface.action import ACTION_SPACES, Action
from carecontact.interface.deltas import DELTAS, DeltaConvention
from carecontact.interface.geometry import (
    euler_xyz_from_matrix,
    matrix_from_euler_xyz,
    matrix_from_vector,
    vector_from_matrix,
)
from carecontact.interface.policy import PolicyCard
from tests.policies.synthetic import SESSION

DOWN = np.array([0.4, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0])
ANY = [
    DeltaConvention(description="", frame=frame, origin=origin, rotation=rotation, unit=(0.05, 0.5), most=(9.0, 9.0))
    for frame, origin, rotation in product(("base", "tool"), ("measured", "target"), ("vector", "euler_xyz"))
]
vectors = arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))
poses = st.tuples(vectors, vectors.filter(lambda v: np.linalg.norm(v) > 0.1)).map(
    lambda parts: np.concatenate([parts[0], Rotation.from_rotvec(2.5 * parts[1]).as_quat(scalar_first=True)])
)


def rotation(pose: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose[3:], scalar_first=True)


@given(vectors)
def test_vectors_and_angles_are_scipys(vector: np.ndarray) -> None:
    turn, about = Rotation.from_rotvec(3 * vector / max(1, np.linalg.norm(vector))), Rotation.from_euler("xyz", vector)
    np.testing.assert_allclose(matrix_from_vector(turn.as_rotvec()), turn.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(vector_from_matrix(turn.as_matrix()), turn.as_rotvec(), atol=1e-12)
    np.testing.assert_allclose(matrix_from_euler_xyz(vector), about.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(euler_xyz_from_matrix(about.as_matrix()), vector, atol=1e-12)


def test_no_turn_and_the_smallest() -> None:
    for size in (0.0, 1e-12, 1e-300):
        vector = np.array([0.0, size, 0.0])
        np.testing.assert_allclose(vector_from_matrix(matrix_from_vector(vector)), vector, rtol=1e-3, atol=1e-30)


@given(vectors, vectors, poses, poses)
def test_osc_is_robosuites_set_goal(shift: np.ndarray, turn: np.ndarray, now: np.ndarray, last: np.ndarray) -> None:
    """The lines of set_goal_position and set_goal_orientation in robosuite's utils/control_utils.py, with scipy in the
    place of its transforms; a turn of nothing keeps the goal's orientation."""
    goal = DELTAS["osc"].target(np.concatenate([shift, turn]), measured=now, last=last)
    np.testing.assert_allclose(goal[:3], now[:3] + 0.05 * shift, atol=1e-15)
    expected = Rotation.from_rotvec(0.5 * turn) * rotation(now) if np.abs(turn).max() > 1e-8 else rotation(last)
    assert (rotation(goal) * expected.inv()).magnitude() < 1e-9


@given(vectors, vectors, poses, poses)
def test_bridge_is_the_transform_of_its_robots(
    shift: np.ndarray, angles: np.ndarray, now: np.ndarray, last: np.ndarray
) -> None:
    """action2transform_local about a tool that is where its target is, times the target's transform."""
    delta = np.concatenate([0.05 * shift, 0.25 * angles])
    goal = DELTAS["bridge"].target(delta, measured=now, last=last)
    turn = np.eye(3)
    for axis, angle in enumerate(delta[3:]):
        c, s, (i, j) = math.cos(angle), math.sin(angle), [(1, 2), (2, 0), (0, 1)][axis]
        about = np.eye(3)
        about[i, i], about[i, j], about[j, i], about[j, j] = c, -s, s, c
        turn = about @ turn
    np.testing.assert_allclose(goal[:3], last[:3] + delta[:3], atol=1e-15)
    np.testing.assert_allclose(rotation(goal).as_matrix(), turn @ rotation(last).as_matrix(), atol=1e-9)


def test_the_tool_s_x_is_its_own() -> None:
    turned = np.concatenate(
        [DOWN[:3], (Rotation.from_euler("z", 90, degrees=True) * rotation(DOWN)).as_quat()[[3, 0, 1, 2]]]
    )
    ahead = np.array([0.1, 0.0, 0.02, 0.0, 0.0, 0.3])
    goal = DELTAS["metres-tool"].target(ahead, measured=DOWN, last=turned)
    np.testing.assert_allclose(goal[:3] - DOWN[:3], [0.0, 0.1, -0.02], atol=1e-12)
    # The tool points down: a turn about its own z is the opposite turn about the base's.
    np.testing.assert_allclose((rotation(goal) * rotation(turned).inv()).as_rotvec(), [0, 0, -0.3], atol=1e-9)


@pytest.mark.parametrize("convention", ANY, ids=lambda c: f"{c.frame} {c.origin} {c.rotation}")
@given(pose=poses, now=poses, last=poses)
def test_back_and_forth(convention: DeltaConvention, pose: np.ndarray, now: np.ndarray, last: np.ndarray) -> None:
    # No numbers of the measured pose mean its own orientation while the last target has another.
    assume((rotation(pose) * rotation(now).inv()).magnitude() > 1e-3)
    numbers = convention.delta(pose, measured=now, last=last)
    assume(convention.rotation == "vector" or abs(abs(0.5 * numbers[4]) - np.pi / 2) > 1e-3)
    again = convention.target(numbers, measured=now, last=last)
    np.testing.assert_allclose(again[:3], pose[:3], atol=1e-9)
    assert (rotation(again) * rotation(pose).inv()).magnitude() < 1e-6
    # And what keeps the last orientation has no rotation.
    kept = convention.delta(np.concatenate([pose[:3], last[3:]]), measured=now, last=last)
    np.testing.assert_array_equal(kept[3:], 0)


@pytest.mark.parametrize("name", DELTAS)
def test_every_convention(name: str) -> None:
    """Contract of the registry: one row each way, bounds that hold, both ends of the gripper."""
    convention = DELTAS[name]
    assert convention.description.endswith(".")
    assert PolicyCard(name="a", action_space="cartesian_delta", delta=name).plain()["delta"] == name
    goal = np.concatenate([DOWN[:3] + 0.3 * convention.unit[0] * convention.most[0], DOWN[3:]])
    row = convention.row(goal, 0.25, measured=DOWN, last=DOWN)
    action = convention.action(row)
    assert action.gripper == pytest.approx(0.25)
    assert action.delta is not None
    np.testing.assert_allclose(convention.target(action.delta, measured=DOWN, last=DOWN), goal, atol=1e-12)
    assert [float(convention.opening(number)) for number in convention.gripper] == [0.0, 1.0]
    far = convention.row(DOWN + [9, -9, 9, 0, 0, 0, 0], 1.0, measured=DOWN, last=DOWN)
    np.testing.assert_allclose(np.abs(far[:3]), convention.most[0])
    wild = convention.action(np.array([1e9, *[0] * 5, convention.gripper[0]]))
    assert wild.delta is not None
    assert (wild.delta == [convention.most[0], 0, 0, 0, 0, 0]).all()
    for bad in (np.zeros(6), np.full(7, np.nan)):
        with pytest.raises(ActionError, match="delta: expected 7 finite numbers"):
            convention.action(bad)


def test_polarity() -> None:
    assert [DELTAS["osc"].action([0] * 6 + [g]).gripper for g in (-1, 0, 1, 1.4)] == [1, 0.5, 0, 0]
    assert [DELTAS["bridge"].action([0] * 6 + [g]).gripper for g in (-0.2, 0, 1)] == [0, 0, 1]


def test_a_card_names_a_convention_for_deltas_and_for_nothing_else() -> None:
    card = PolicyCard(name="a", action_space="cartesian_delta")
    assert card.delta == "osc"
    assert replace(card, delta="bridge").delta == "bridge"
    wrongs: list[dict[str, Any]] = [{"action_space": "cartesian_delta", "delta": "brige"}, {"delta": "osc"}]
    for wrong in wrongs:
        with pytest.raises(ContractError, match=r"PolicyCard.delta: expected one of bridge, .*osc"):
            PolicyCard(name="a", **wrong)
    assert "delta" not in PolicyCard(name="a").plain()


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (
            np.zeros(7),
            r"delta: expected 6 numbers .* got shape \(7,\) float64; seven numbers look like a delta and",
        ),
        (np.zeros(3), r"got shape \(3,\) float64; three numbers look like a translation"),
        (np.array(["a"] * 6), "delta: expected 6 numbers"),
        (np.array([0, 0, np.nan, 0, 0, 0]), "delta: expected finite numbers"),
    ],
)
def test_what_no_convention_accepts(bad: np.ndarray, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        ACTION_SPACES["cartesian_delta"].check(Action(delta=bad), SESSION)


def test_a_delta_policy_gives_no_poses_and_a_pose_policy_no_deltas() -> None:
    for space, action in (
        ("cartesian_delta", Action(pose_tcp_in_base=DOWN)),
        ("cartesian_pose", Action(delta=np.zeros(6))),
    ):
        with pytest.raises(ActionError, match="this field is not one of the card's action space"):
            ACTION_SPACES[space].check(action, SESSION)
