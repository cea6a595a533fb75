from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import pytest

from carecontact.contract.action import MAX_CHUNK, Action, check_action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import Policy
from carecontact.contract.session import Session
from carecontact.errors import LanguageError
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, NEAR_SPEED_M_S, Leg
from carecontact.policies.state_machine import fixed_values as fixed
from carecontact.policies.state_machine.candidates import candidates, reachable
from carecontact.policies.state_machine.policy import StateMachine
from carecontact.policies.state_machine.primitives import touch
from carecontact.protocols import load_protocol
from carecontact.sight import region_from_observation
from tests.sight.lying_person import HEIGHT, LIMB_RADIUS, WIDTH, Person, change_view, observe

MakeSession = Callable[..., Session]
PROMPTS = [task.prompt for task in load_protocol().tasks]


def plan(observation: Observation, prompt: str, session: Session) -> list[Action]:
    policy = StateMachine()
    policy.configure(session)
    policy.reset(prompt)
    return list(policy.act(observation))


def poses_of(actions: list[Action]) -> np.ndarray:
    return np.array([action.pose_tcp_in_base for action in actions])


@pytest.mark.parametrize("prompt", PROMPTS)
def test_every_task_has_a_plan_within_all_limits(
    observation: Observation, person: Person, session: MakeSession, prompt: str
) -> None:
    actions = plan(observation, prompt, session())
    assert len(actions) <= MAX_CHUNK
    assert len(actions) / CONTROL_HZ < 25
    assert [action.done for action in actions] == [False] * (len(actions) - 1) + [True]
    for action in actions:
        check_action(action, session().action_bounds)
    poses = np.vstack([observation.pose_tcp_in_base, poses_of(actions)])
    speed = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) * CONTROL_HZ
    assert speed.max() <= FREE_SPEED_M_S + 1e-9
    near = person.clearance(poses[1:, :3]) < fixed.NEAR_M
    assert near.any()
    assert speed[near].max() <= NEAR_SPEED_M_S + 1e-9
    # Ends well clear of the person.
    assert person.clearance(poses[-1:, :3])[0] > 0.05


def test_touch_ends_on_the_named_region(observation: Observation, person: Person, session: MakeSession) -> None:
    poses = poses_of(plan(observation, "gently touch the right forearm", session()))
    lowest = poses[poses[:, 2].argmin(), :3]
    middle = (person.elbow + person.wrist) / 2
    assert np.linalg.norm(lowest[:2] - middle[:2]) < 0.01
    assert lowest[2] == pytest.approx(2 * LIMB_RADIUS - fixed.TOUCH_DEPTHS_M[0], abs=0.003)
    assert (np.abs(poses[:, 2] - lowest[2]) < 1e-9).sum() >= 1.5 * CONTROL_HZ


def test_the_way_goes_over_the_person(observation: Observation, person: Person, session: MakeSession) -> None:
    poses = poses_of(plan(observation, "gently touch the abdomen", session()))
    first_near = int(np.argmax(person.clearance(poses[:, :3]) < 0.05))
    goal = poses[poses[:, 2].argmin(), :2]
    assert np.linalg.norm(poses[first_near, :2] - goal) < 1e-6


def test_a_blank_image_ends_without_touching(session: MakeSession, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        actions = plan(observe(None), "gently touch the right forearm", session())
    assert actions == [Action(done=True)]
    assert "nobody was found" in caplog.text


def test_a_hidden_arm_ends_without_touching(observation: Observation, session: MakeSession) -> None:
    empty = dict(observation.cameras["overhead"].masks or {}, human=np.zeros((HEIGHT, WIDTH), bool))
    actions = plan(change_view(observation, masks=empty), "push the right forearm", session())
    assert actions == [Action(done=True)]


def test_out_of_the_workspace_ends_without_touching(
    observation: Observation, session: MakeSession, caplog: pytest.LogCaptureFixture
) -> None:
    actions = plan(observation, "gently touch the right forearm", session(low=(-0.2, -1.1, 0.3)))
    assert actions == [Action(done=True)]
    assert "workspace" in caplog.text


def test_an_arm_that_is_not_seen_ends_without_touching(observation: Observation, session: MakeSession) -> None:
    assert plan(observation, "gently touch the left forearm", session()) == [Action(done=True)]


def test_an_instruction_that_is_not_understood_is_refused() -> None:
    with pytest.raises(LanguageError, match="which forearm"):
        StateMachine().reset("touch the forearm")


def test_the_card() -> None:
    policy = StateMachine()
    assert isinstance(policy, Policy)
    assert policy.card.language_backend == "rules-v1"
    assert policy.card.cameras == ("overhead",)


@pytest.mark.parametrize(("region", "pushes"), [("forearm", True), ("abdomen", False)])
def test_the_choice_is_bounded(observation: Observation, region: str, pushes: bool) -> None:
    geometry = region_from_observation(observation, region)  # pyright: ignore[reportArgumentType]
    found = candidates(geometry, start_pose=observation.pose_tcp_in_base, travel_height_m=0.3, bounds=None)
    assert len(found) <= 40
    assert {"touch", "scrub"} <= {c.option.primitive for c in found}
    assert any(c.option.primitive == "push" for c in found) == pushes
    assert len({c.option for c in found}) == len(found)


def test_reach(observation: Observation) -> None:
    forearm = region_from_observation(observation, "forearm")
    legs = touch(forearm, key_point=0.5, depth_m=0.012, speed_m_s=0.03)
    assert reachable(legs)
    for metres in (0.5, -0.3):
        shift = metres * forearm.centre_m / np.linalg.norm(forearm.centre_m)
        moved = [Leg(points=leg.points + shift, quat_wxyz=leg.quat_wxyz, speed_m_s=0.1) for leg in legs]
        assert not reachable(moved)


def test_a_person_who_lies_too_far_away(session: MakeSession, caplog: pytest.LogCaptureFixture) -> None:
    person = Person(shoulder=np.array([0.95, -0.75, LIMB_RADIUS]))
    assert plan(observe(person), "gently touch the right upper arm", session()) == [Action(done=True)]
    assert "workspace" in caplog.text
