"""Joint action spaces: what each accepts, refuses and clips."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carecontact.contract.action import ACTION_SPACES, Action
from carecontact.errors import ActionError
from tests.policies.synthetic import SESSION

INSIDE = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0])
JOINT_SPACES = [name for name, space in ACTION_SPACES.items() if space.in_joints]


@pytest.mark.parametrize("name", JOINT_SPACES)
def test_seven_numbers_pass_and_nothing_keeps_the_last_target(name: str) -> None:
    space = ACTION_SPACES[name]
    checked = space.check(Action(joint=INSIDE.astype(np.float32), gripper=0.5, done=True), SESSION)
    np.testing.assert_allclose(checked.joint, INSIDE)
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
        (Action(joint=INSIDE, gripper=-1), r"gripper: expected an opening in \[0, 1\], got -1"),
        (
            Action(pose_tcp_in_base=np.zeros(7)),
            "pose_tcp_in_base: this field is not one of the card's action space; give joint",
        ),
        (Action(joint=INSIDE, stiffness=(400.0, 20.0)), "stiffness: this field is not one of the card's action space"),
    ],
)
def test_what_no_joint_space_accepts_is_named(name: str, given: Action, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        ACTION_SPACES[name].check(given, SESSION)


def test_a_pose_policy_cannot_give_joints() -> None:
    with pytest.raises(ActionError, match="joint: this field is not one of the card's action space; give pose_tcp"):
        ACTION_SPACES["cartesian_pose"].check(Action(joint=INSIDE), SESSION)


@pytest.mark.parametrize(("joint", "value", "hint"), [(4, 0.0, ""), (2, -90.0, "; the numbers look like degrees")])
def test_a_target_beyond_a_joint_limit_names_joint_and_limits(joint: int, value: float, hint: str) -> None:
    beyond = INSIDE.copy()
    beyond[joint - 1] = value
    low, high = SESSION.joint_low_rad[joint - 1], SESSION.joint_high_rad[joint - 1]
    expected = f"joint: expected {low:g} to {high:g} rad for joint {joint}, got {value:g}{hint}"
    with pytest.raises(ActionError) as refused:
        ACTION_SPACES["joint_position"].check(Action(joint=beyond), SESSION)
    assert str(refused.value) == expected


def test_clip_moves_joints_onto_their_limits_and_nothing_else() -> None:
    space = ACTION_SPACES["joint_position"]
    inside = Action(joint=INSIDE)
    assert space.clip(inside, SESSION) is inside
    clipped = space.clip(Action(joint=INSIDE + [9, 0, 0, 9, 0, -9, 0]), SESSION)
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
