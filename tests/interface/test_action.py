"""check_action: the border behind which every action is inside the published bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carecontact.errors import ActionError
from carecontact.interface.action import ACTION_SPACES, Action
from carecontact.interface.action_spaces import check_action, clip_action
from carecontact.interface.robot import ActionBounds
from tests.policies.synthetic import SESSION

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
def test_numbers_that_overflow_are_refused_without_a_warning(bad: np.ndarray) -> None:
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
def test_a_gripper_outside_its_range_is_refused_with_what_the_numbers_mean(bad: float, hint: str) -> None:
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


# Joint action spaces: what each accepts, refuses and clips.

JOINT_SPACES_INSIDE = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0])
JOINT_SPACES = [name for name, space in ACTION_SPACES.items() if space.in_joints]


@pytest.mark.parametrize("name", JOINT_SPACES)
def test_seven_numbers_pass_and_nothing_keeps_the_last_target(name: str) -> None:
    space = ACTION_SPACES[name]
    checked = space.check(Action(joint=JOINT_SPACES_INSIDE.astype(np.float32), gripper=0.5, done=True), SESSION)
    np.testing.assert_allclose(checked.joint, JOINT_SPACES_INSIDE)
    assert checked.joint.dtype == np.float64
    assert (checked.gripper, checked.done) == (0.5, True)
    assert space.check(Action(), SESSION) == Action()


@pytest.mark.parametrize("name", JOINT_SPACES)
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (Action(joint=np.zeros(8)), r"joint: expected 7 numbers \[.*\], got shape \(8,\)"),
        (Action(joint=np.array(["a"] * 7)), "joint: expected 7 numbers"),
        (Action(joint=np.full(7, np.nan)), "joint: expected finite numbers"),
        (Action(joint=JOINT_SPACES_INSIDE, gripper=-1), r"gripper: expected an opening in \[0, 1\], got -1"),
        (
            Action(pose_tcp_in_base=np.zeros(7)),
            "pose_tcp_in_base: this field is not one of the card's action space; give joint",
        ),
        (
            Action(joint=JOINT_SPACES_INSIDE, stiffness=(400.0, 20.0)),
            "stiffness: this field is not one of the card's action space",
        ),
    ],
)
def test_what_no_joint_space_accepts_is_named(name: str, given: Action, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        ACTION_SPACES[name].check(given, SESSION)


def test_a_pose_policy_cannot_give_joints() -> None:
    with pytest.raises(ActionError, match="joint: this field is not one of the card's action space; give pose_tcp"):
        ACTION_SPACES["cartesian_pose"].check(Action(joint=JOINT_SPACES_INSIDE), SESSION)


@pytest.mark.parametrize(("joint", "value", "hint"), [(4, 0.0, ""), (2, -90.0, "; the numbers look like degrees")])
def test_a_target_beyond_a_joint_limit_names_joint_and_limits(joint: int, value: float, hint: str) -> None:
    beyond = JOINT_SPACES_INSIDE.copy()
    beyond[joint - 1] = value
    low, high = SESSION.joint_low_rad[joint - 1], SESSION.joint_high_rad[joint - 1]
    expected = f"joint: expected {low:g} to {high:g} rad for joint {joint}, got {value:g}{hint}"
    with pytest.raises(ActionError) as refused:
        ACTION_SPACES["joint_position"].check(Action(joint=beyond), SESSION)
    assert str(refused.value) == expected


def test_clip_moves_joints_onto_their_limits_and_nothing_else() -> None:
    space = ACTION_SPACES["joint_position"]
    inside = Action(joint=JOINT_SPACES_INSIDE)
    assert space.clip(inside, SESSION) is inside
    clipped = space.clip(Action(joint=JOINT_SPACES_INSIDE + [9, 0, 0, 9, 0, -9, 0]), SESSION)
    np.testing.assert_allclose(
        clipped.joint, [SESSION.joint_high_rad[0], 0, 0, SESSION.joint_high_rad[3], 0, SESSION.joint_low_rad[5], 0]
    )
    space.check(clipped, SESSION)
    for hopeless in (Action(joint=np.full(7, np.nan)), Action(joint=np.zeros(3)), Action()):
        assert space.clip(hopeless, SESSION) is hopeless


def test_velocities_of_any_size_pass_because_the_controller_scales_them() -> None:
    space = ACTION_SPACES["droid_joint_velocity"]
    fast = Action(joint=np.array([3.0, -4.0, 0, 0, 0, 0, 0]))
    assert space.clip(fast, SESSION) is fast
    np.testing.assert_array_equal(space.check(fast, SESSION).joint, fast.joint)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stiffness": (100.0,) * 3 + (20.0,) * 2}, "expected 2 numbers .* or 6 .* got 5"),
        ({"stiffness": (400, 400, 50, 20, 20, 20)}, r"expected 100 to 1000 N/m, or 0 on an axis with a feedforward"),
        ({"stiffness": (400, 400, 400, 20, 20, 80)}, "expected 5 to 50 N m/rad, or 0"),
        ({"stiffness": (0, 20.0)}, "expected 100 to 1000 N/m, got 0"),
        ({"damping_ratio": 0.1}, r"damping_ratio: expected 0.3 to 2 \(1 is critical damping\), got 0.1"),
        ({"damping_ratio": float("nan")}, "damping_ratio: .* got nan"),
        ({"wrench_in_tcp": np.zeros(3)}, "wrench_in_tcp: expected 6 numbers"),
        ({"wrench_in_tcp": np.array([0, 0, 41.0, 0, 0, 0])}, "force of at most 40 N"),
        ({"wrench_in_tcp": np.array([0, 0, 0, 0, 0, 5.1])}, "torque of at most 5 N m"),
        ({"wrench_in_tcp": np.array([np.nan, 0, 0, 0, 0, 0])}, "wrench_in_tcp: .* got .nan"),
    ],
)
def test_a_compliance_out_of_bounds_is_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ActionError, match=message):
        ACTION_SPACES["cartesian_pose"].check(Action(**given), SESSION)


def test_a_single_axis_may_be_free() -> None:
    free = (400.0, 0.0, 400.0, 0.0, 20.0, 20.0)
    assert ACTION_SPACES["cartesian_pose"].check(Action(stiffness=free), SESSION).stiffness == free
