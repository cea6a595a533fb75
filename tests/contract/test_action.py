"""check_action: the border behind which every action is inside the published bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carecontact.contract.action import Action, check_action, clip_action
from carecontact.contract.session import ActionBounds
from carecontact.errors import ActionError

LOW, HIGH = (0.0, -0.6, 0.1), (1.0, 0.5, 0.75)
BOUNDS = ActionBounds(
    workspace_low_m=LOW,
    workspace_high_m=HIGH,
    translational_stiffness=(100.0, 1000.0),
    rotational_stiffness=(5.0, 50.0),
)
INSIDE = (0.5, 0.0, 0.3)


def pose(*position: float, quat: tuple[float, ...] = (0.0, 1.0, 0.0, 0.0)) -> np.ndarray:
    return np.array([*position, *quat])


def test_quaternion_is_made_unit_and_the_callers_array_stays() -> None:
    given_pose = pose(*INSIDE, quat=(0.603, 0.0, 0.804, 0.0))
    kept = given_pose.copy()
    checked = check_action(Action(pose_tcp_in_base=given_pose), BOUNDS).pose_tcp_in_base
    assert checked is not None
    np.testing.assert_allclose(checked, [*INSIDE, 0.6, 0.0, 0.8, 0.0], atol=1e-12)
    np.testing.assert_array_equal(given_pose, kept)


def test_empty_action_keeps_everything() -> None:
    assert check_action(Action(), BOUNDS) == Action()


def test_other_fields_arrive() -> None:
    checked = check_action(Action(stiffness=(400, 20), gripper=0.25, done=True), BOUNDS)
    assert checked == Action(stiffness=(400.0, 20.0), gripper=0.25, done=True)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -0.01, 1.01, 9.2e18])
def test_a_gripper_opening_is_a_share(bad: float) -> None:
    with pytest.raises(ActionError, match=r"gripper: expected an opening in \[0, 1\], got "):
        check_action(Action(gripper=bad), BOUNDS)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bad", [pose(1e308, 0.0, 0.3), pose(*INSIDE, quat=(1e308, 0, 1e308, 0))])
def test_numbers_that_overflow_are_told_without_a_warning(bad: np.ndarray) -> None:
    with pytest.raises(ActionError, match=r"inside the workspace|quaternion of norm"):
        check_action(Action(pose_tcp_in_base=bad), BOUNDS)


def test_whole_numbers_are_numbers() -> None:
    whole = ActionBounds(
        workspace_low_m=(0, 0, 0),
        workspace_high_m=(3, 3, 3),
        translational_stiffness=(1, 2),
        rotational_stiffness=(1, 2),
    )
    checked = check_action(Action(pose_tcp_in_base=np.array([1, 2, 3, 1, 0, 0, 0])), whole).pose_tcp_in_base
    assert checked is not None
    assert checked.dtype == np.float64
    assert checked.tolist() == [1, 2, 3, 1, 0, 0, 0]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("side", "bound"), [(-1, LOW), (1, HIGH)], ids=["low", "high"])
def test_workspace_faces_belong_to_it_and_nothing_beyond_does(axis: int, side: int, bound: tuple[float, ...]) -> None:
    position = list(INSIDE)
    position[axis] = bound[axis]
    check_action(Action(pose_tcp_in_base=pose(*position)), BOUNDS)
    position[axis] += side * 1e-6
    with pytest.raises(ActionError, match=r"pose_tcp_in_base: expected a position inside the workspace .* got "):
        check_action(Action(pose_tcp_in_base=pose(*position)), BOUNDS)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros(6), r"expected 7 numbers .* got shape \(6,\)"),
        (np.zeros(6), r"; six numbers look like x y z and roll pitch yaw: turn the angles into a quaternion w x y z$"),
        (np.zeros(3), "; three numbers look like a position: add the quaternion"),
        (np.zeros(8), "; eight numbers look like a pose and a gripper"),
        (np.zeros((5, 7)), r"; these look like 5 poses: send a list with one action for each$"),
        (np.zeros((1, 7)), r"got shape \(1, 7\) float64; this looks like a pose in a list of its own: leave the outer"),
        (np.zeros(0), r"got shape \(0,\)"),
        (np.ones(7, bool), "bool"),
        (np.array(list("abcdefg")), "got shape"),
        (pose(*INSIDE).astype(complex), "complex128"),
        (pose(np.nan, 0.0, 0.3), "finite"),
        (pose(*INSIDE, quat=(np.inf, 0, 0, 0)), "finite"),
        (pose(*INSIDE, quat=(0, 0, 0, 0)), "expected a quaternion of norm 1, got 0"),
        (pose(*INSIDE, quat=(0.98, 0, 0, 0)), "norm 1, got 0.98"),
        (pose(*INSIDE, quat=(0, 0, 0, 1.02)), "norm 1, got 1.02"),
    ],
)
def test_wrong_pose_is_named(bad: Any, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        check_action(Action(pose_tcp_in_base=bad), BOUNDS)


@pytest.mark.parametrize(
    ("position", "message"),
    [
        (
            (500.0, 0.0, 300.0),
            r"the position \[500.0, 0.0, 300.0\] looks like millimetres: send metres; the workspace is",
        ),
        ((500.0, 0.0, 900.0), "expected a position inside the workspace"),
        ((50.0, 0.0, 100.0), "expected a position inside the workspace"),
        (
            (0.01, -0.002, -0.01),
            r"the position \[0.01, -0.002, -0.01\] looks like a difference to the tool's pose: send",
        ),
        ((0.5, 0.0, -0.01), "expected a position inside the workspace"),
    ],
)
def test_a_position_in_another_unit_or_frame_is_named_before_the_bounds(
    position: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ActionError, match=f"^pose_tcp_in_base: {message}"):
        check_action(Action(pose_tcp_in_base=pose(*position)), BOUNDS)


def test_a_small_difference_inside_the_workspace_is_named_by_its_missing_rotation() -> None:
    with pytest.raises(ActionError, match=r"norm 1, got 0; the position .* looks like a difference to the tool's pose"):
        check_action(Action(pose_tcp_in_base=pose(0.01, 0.0, 0.101, quat=(0, 0, 0, 0))), BOUNDS)


@pytest.mark.parametrize(("bad", "hint"), [(-1.0, r": of a range from -1 to 1 send \(1 \+ g\) / 2, or "), (2.0, "$")])
def test_a_gripper_outside_its_range_is_told_what_the_numbers_mean(bad: float, hint: str) -> None:
    with pytest.raises(ActionError, match=rf"got {bad}; 1 is open and 0 is closed{hint}"):
        check_action(Action(gripper=bad), BOUNDS)


@pytest.mark.parametrize("good", [(100.0, 5.0), (1000.0, 50.0), (400.0, 20.0)])
def test_stiffness_bounds_are_allowed_values(good: tuple[float, float]) -> None:
    assert check_action(Action(stiffness=good), BOUNDS).stiffness == good


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ((99.9, 20.0), "stiffness: expected 100 to 1000 N/m, got 99.9"),
        ((1000.1, 20.0), "got 1000.1"),
        ((400.0, 4.9), "stiffness: expected 5 to 50 N m/rad, got 4.9"),
        ((400.0, 50.1), "got 50.1"),
        ((float("nan"), 20.0), "N/m, got nan"),
        ((400.0, float("nan")), "N m/rad, got nan"),
        ((400.0,), "about x y z\\), got 1"),
        ((400.0, 20.0, 20.0), "about x y z\\), got 3"),
    ],
)
def test_stiffness_outside_its_bounds_is_refused_not_clamped(bad: Any, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        check_action(Action(stiffness=bad), BOUNDS)


@given(
    arrays(np.float64, 7, elements=st.floats(-2, 2) | st.sampled_from([np.nan, np.inf, -np.inf])),
    st.tuples(st.floats(), st.floats()),
)
def test_what_passes_is_inside_the_bounds(candidate: np.ndarray, stiffness: tuple[float, float]) -> None:
    try:
        checked = check_action(Action(pose_tcp_in_base=candidate), BOUNDS).pose_tcp_in_base
    except ActionError:
        checked = None
    if checked is not None:
        assert (checked[:3] >= LOW).all()
        assert (checked[:3] <= HIGH).all()
        assert np.linalg.norm(checked[3:]) == pytest.approx(1.0, abs=1e-12)
    allowed = 100 <= stiffness[0] <= 1000 and 5 <= stiffness[1] <= 50
    try:
        check_action(Action(stiffness=stiffness), BOUNDS)
    except ActionError:
        assert not allowed
    else:
        assert allowed


@given(arrays(np.float64, 3, elements=st.floats(-3, 3)))
def test_clipping_moves_a_position_to_the_nearest_point_of_the_workspace(position: np.ndarray) -> None:
    action = Action(pose_tcp_in_base=pose(*position), stiffness=(400.0, 20.0), done=True)
    clipped = clip_action(action, BOUNDS)
    assert check_action(clipped, BOUNDS).done
    inside = bool(np.all(position >= LOW) and np.all(position <= HIGH))
    assert (clipped is action) == inside
    np.testing.assert_array_equal(clipped.pose_tcp_in_base[:3], np.clip(position, LOW, HIGH))
    np.testing.assert_array_equal(clipped.pose_tcp_in_base[3:], action.pose_tcp_in_base[3:])


@pytest.mark.parametrize("bad", [None, pose(9.0, np.nan, 0.3), np.zeros(6), np.array(["a"] * 7)])
def test_clipping_leaves_alone_what_the_check_refuses(bad: Any) -> None:
    action = Action(pose_tcp_in_base=bad)
    assert clip_action(action, BOUNDS) is action
