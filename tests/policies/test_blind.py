from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action import Action
from carecontact.interface.action_spaces import check_action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.policies.blind import HEIGHT_M, HOLD_S, WAIT_S, FeintAndWait, Hover, RandomTargets
from carecontact.policies.motion import CONTROL_HZ, ROTATION_SPEED_RAD_S, Leg, sample, slerp, tool_quat
from carecontact.policies.state_machine import StateMachine
from tests.interface.lying_person import LIMB_RADIUS, Person, observe
from tests.policies.synthetic import BOUNDS, SESSION, synthetic_observation, synthetic_view

PROMPT = "gently touch the right forearm"


def over_the_forearm(person: Person) -> np.ndarray:
    return (person.elbow + person.wrist) / 2 + [0.0, 0.0, LIMB_RADIUS + HEIGHT_M]


@pytest.mark.parametrize("verb", ["push", "tap"])
def test_hover_waits_over_the_region_and_never_comes_nearer(
    verb: str, person: Person, observation: Observation
) -> None:
    """Whatever the action is, also one of another package."""
    policy = Hover()
    policy.reset(f"{verb} the right forearm")
    actions = policy.act(observation)
    poses = np.array([check_action(action, BOUNDS).pose_tcp_in_base for action in actions])
    assert [action.done for action in actions] == [False] * (len(actions) - 1) + [True]
    waiting = np.linalg.norm(poses[:, :3] - over_the_forearm(person), axis=1) < 0.01
    assert waiting.sum() / policy.card.control_hz == pytest.approx(HOLD_S, abs=1.5)
    assert np.ptp(poses[waiting][10:-10, :3], axis=0).max() == pytest.approx(0, abs=0.01)
    assert person.clearance(poses[:, :3]).min() > HEIGHT_M - 0.01
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) * policy.card.control_hz
    assert steps.max() <= 0.25 + 1e-9


def test_hover_travels_below_the_top_of_the_workspace(observation: Observation) -> None:
    """Its targets were refused on bathing-droid-v1, where heavy persons lie close under that top."""
    start, top = observation.pose_tcp_in_base.copy(), 0.3
    start[2] = 0.2
    highest = []
    for high in (BOUNDS.workspace_high_m[2], top):
        policy = Hover()
        policy.configure(
            dataclasses.replace(SESSION, action_bounds=dataclasses.replace(BOUNDS, workspace_high_m=(1.0, 0.6, high)))
        )
        policy.reset(PROMPT)
        actions = policy.act(dataclasses.replace(observation, pose_tcp_in_base=start))
        highest.append(max(action.pose_tcp_in_base[2] for action in actions))
    assert highest[0] > top
    assert highest[1] == top


def test_hover_that_finds_no_person_ends_where_it_is() -> None:
    policy = Hover()
    policy.reset("gently touch the right upper arm")
    assert policy.act(observe(None)) == [Action(done=True)]


def targets(instruction: str, *, seed: int = 0) -> np.ndarray:
    policy = RandomTargets()
    policy.configure(SESSION)
    policy.reset(instruction)
    actions = policy.act(synthetic_observation(cameras={"overhead": synthetic_view(seed=seed)}))
    assert not any(action.done for action in actions)
    return np.array([check_action(action, BOUNDS).pose_tcp_in_base for action in actions])


def test_fills_the_trial_and_the_workspace() -> None:
    found = targets("touch")
    assert len(found) / RandomTargets.card.control_hz == SESSION.time_limit_s
    low, high = np.array(BOUNDS.workspace_low_m), np.array(BOUNDS.workspace_high_m)
    assert ((found[:, :3].max(0) - found[:, :3].min(0)) > 0.8 * (high - low)).all()


def test_same_words_and_image_same_targets_and_others_others() -> None:
    first = targets("touch")
    np.testing.assert_array_equal(first, targets("touch"))
    assert (first != targets("scrub")).any()
    assert (first != targets("touch", seed=1)).any()


def test_needs_what_its_card_asks_for() -> None:
    policy = RandomTargets()
    policy.configure(SESSION)
    blind = dataclasses.replace(synthetic_view(), depth=None)
    with pytest.raises(ContractError, match="depth image"):
        policy.act(synthetic_observation(cameras={"overhead": blind}))


def test_it_comes_near_goes_back_waits_and_then_acts_as_its_base(person: Person, observation: Observation) -> None:
    policy, base, seen = FeintAndWait(), StateMachine(), observation
    for each in (policy, base):
        each.configure(SESSION)
        each.reset(PROMPT)
    feint = policy.act(seen)
    assert not any(action.done for action in feint)
    poses = np.array([check_action(a, BOUNDS).pose_tcp_in_base for a in feint if a.pose_tcp_in_base is not None])
    assert np.linalg.norm(poses[:, :3] - over_the_forearm(person), axis=1).min() < 0.01
    assert poses[-1, :3] == pytest.approx(seen.pose_tcp_in_base[:3])
    assert abs(poses[-1, 3:] @ seen.pose_tcp_in_base[3:]) == pytest.approx(1)
    assert len(feint) - len(poses) == WAIT_S * policy.card.control_hz
    wanted, found = base.act(seen), policy.act(seen)
    assert [a.done for a in found] == [a.done for a in wanted]
    assert all(np.array_equal(a.pose_tcp_in_base, b.pose_tcp_in_base) for a, b in zip(found, wanted, strict=True))
    assert policy.take_notes()["chosen"] == base.take_notes()["chosen"]


def test_a_second_trial_begins_with_a_feint_again(observation: Observation) -> None:
    policy, first = FeintAndWait(), []
    for _ in range(2):
        policy.reset(PROMPT)
        first.append(len(policy.act(observation)))
    assert first[0] == first[1]


@pytest.mark.parametrize("base", ["oracle", "feint-and-wait", "unknown", "random"])
def test_what_cannot_act_afterwards_is_refused(base: str) -> None:
    with pytest.raises(ConfigError, match=f"base: .*{base}"):
        FeintAndWait(base=base)


DOWN = np.array([0.0, 1.0, 0.0, 0.0])


@given(
    goal=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    speed=st.floats(0.02, 0.25),
    angle=st.floats(0, 3.0),
)
def test_sampled_motion_keeps_its_speed_and_arrives(
    goal: tuple[float, float, float], speed: float, angle: float
) -> None:
    start = np.array([0.0, 0.0, 0.0, *DOWN])
    quat = slerp(DOWN, np.array([0.0, 0.0, 1.0, 0.0]), angle / np.pi)
    poses = np.array([start, *sample([Leg(points=np.array([goal]), quat_wxyz=quat, speed_m_s=speed)], start)])
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) * CONTROL_HZ
    turns = 2 * np.arccos(np.clip(np.abs((poses[1:, 3:] * poses[:-1, 3:]).sum(1)), 0, 1)) * CONTROL_HZ
    assert (steps <= speed * (1 + 1e-9)).all()
    assert (turns <= ROTATION_SPEED_RAD_S + 1e-3).all()
    if len(poses) > 1:
        np.testing.assert_allclose(poses[-1, :3], goal, atol=1e-9)
        assert abs(poses[-1, 3:] @ quat) == pytest.approx(1.0)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1)


def test_a_hold_lasts_as_long_as_it_says() -> None:
    start = np.array([0.0, 0.0, 0.0, *DOWN])
    leg = Leg(points=np.array([[0.0, 0, 0.1]]), quat_wxyz=DOWN, speed_m_s=0.1, hold_s=1.5)
    poses = np.array(list(sample([leg], start)))
    assert (poses[:, 2] == 0.1).sum() == 1 + 30


def test_tool_points_where_it_should() -> None:
    rotation = matrix_from_quat(tool_quat(np.array([0.0, 0.3, -1.0]), np.array([1.0, 0.0, 0.0])))
    np.testing.assert_allclose(rotation[:, 2], np.array([0, 0.3, -1]) / np.hypot(0.3, 1), atol=1e-9)
    np.testing.assert_allclose(rotation[:, 0], [1, 0, 0], atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
