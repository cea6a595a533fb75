"""Look-and-press before the synthetic person, on a plant of one spring, one damper and a skin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from carecontact.interface.action import Action
from carecontact.interface.action_spaces import check_action, clip_action
from carecontact.interface.observation import Observation
from carecontact.interface.robot import Session
from carecontact.policies.look_and_press import MISSED_M, MOVED_M, WASH_N, LookAndPress
from carecontact.policies.motion import CONTROL_HZ
from carecontact.policies.pressing import FORCE_N, SOFT
from carecontact.policies.state_machine import StateMachine
from tests.interface.lying_person import LIMB_RADIUS, Person, observe
from tests.policies.test_mean_person_force import Plant, held_n

TOUCH, SCRUB, PUSH = (f"gently {words} the right forearm" for words in ("touch", "scrub", "push"))
SKIN_M = 2 * LIMB_RADIUS
MakeSession = Callable[..., Session]


def run(
    plant: Plant, session: Session, first: Observation, *, later: Observation | None = None, prompt: str = TOUCH
) -> tuple[list[Action], dict[str, object]]:
    """Return every action of a trial and its notes. The picture is ``later`` from the second look on."""
    policy, sent, seen = LookAndPress(), list[Action](), first
    policy.configure(session)
    policy.reset(prompt)
    while not (sent and sent[-1].done):
        now = replace(seen, pose_tcp_in_base=plant.pose.copy(), sim_time_s=len(sent) / CONTROL_HZ)
        for action in policy.act(now):
            plant.step(check_action(clip_action(action, session.action_bounds), session.action_bounds))
            sent.append(action)
            if action.look:
                seen = later or first
        assert len(sent) < 30 * CONTROL_HZ
    return sent, policy.take_notes()


def looks(sent: list[Action]) -> int:
    return sum(bool(action.look) for action in sent)


@pytest.mark.parametrize(("bias_n", "friction_n"), [(0.0, 0.0), (-1.5, 0.5), (1.5, 0.5), (0.5, 1.5)])
@pytest.mark.parametrize("shift_m", [-0.02, 0.01])
def test_the_force_is_right_wherever_the_skin_is_and_whatever_the_arm_adds(
    observation: Observation, session: MakeSession, bias_n: float, friction_n: float, shift_m: float
) -> None:
    plant = Plant(lambda place: SKIN_M + shift_m, bias_n=bias_n, friction_n=friction_n)
    sent, notes = run(plant, session(), observation)
    assert held_n(plant) == pytest.approx(FORCE_N, abs=friction_n + 0.3)
    assert max(plant.forces) < 6.0
    assert plant.forces[-1] == 0.0, "it has left"
    assert looks(sent) == 1
    assert notes["arms_bias_n"] == pytest.approx(bias_n, abs=0.3)
    assert notes["arms_friction_n"] == pytest.approx(friction_n, abs=0.3)


def test_a_scrub_presses_on_its_whole_way_and_the_arm_is_firm_again_afterwards(
    observation: Observation, session: MakeSession
) -> None:
    plant = Plant(lambda place: SKIN_M)
    sent, _ = run(plant, session(), observation, prompt=SCRUB)
    assert held_n(plant) == pytest.approx(WASH_N, abs=0.4)
    soft = [action for action in sent if action.stiffness == SOFT]
    places = np.array([action.pose_tcp_in_base for action in soft])
    assert np.ptp(places[:, :2], axis=0).max() > 0.05
    firm = next(action for action in reversed(sent) if action.stiffness is not None)
    assert firm.stiffness == (400.0, 20.0)
    assert firm.wrench_in_tcp is not None
    assert not firm.wrench_in_tcp.any()


@pytest.mark.parametrize(("by_m", "presses"), [(0.5 * MOVED_M, 1), (2 * MOVED_M, 2)])
def test_a_person_who_was_moved_is_touched_again_where_they_are(
    observation: Observation, session: MakeSession, by_m: float, presses: int
) -> None:
    person = Person()
    moved = observe(replace(person, shoulder=person.shoulder - [by_m, 0.0, 0.0]))
    plant = Plant(lambda place: SKIN_M)
    sent, _ = run(plant, session(), observation, later=moved)
    touching = np.array(plant.forces) > 0.1
    assert np.count_nonzero(np.diff(touching.astype(int)) == 1) == presses
    assert looks(sent) == 1, "after the second try there is no time for a third"


def test_skin_that_is_not_there_is_not_followed_down(observation: Observation, session: MakeSession) -> None:
    plant = Plant(lambda place: -1.0)
    lowest: list[float] = []
    step = plant.step
    plant.step = lambda action: (step(action), lowest.append(float(plant.pose[2])))[0]
    sent, _ = run(plant, session(), observation)
    assert SKIN_M - MISSED_M - 0.02 < min(lowest) < SKIN_M - 0.5 * MISSED_M
    assert sent[-1].done


def test_a_push_is_the_state_machines(observation: Observation, session: MakeSession) -> None:
    sent, notes = run(Plant(lambda place: -1.0), session(), observation, prompt=PUSH)
    policy = StateMachine()
    policy.configure(session())
    policy.reset(PUSH)
    expected = policy.act(replace(observation, pose_tcp_in_base=Plant(lambda place: -1.0).pose))
    poses, wanted = (np.array([action.pose_tcp_in_base for action in actions]) for actions in (sent, expected))
    np.testing.assert_array_equal(poses, wanted)
    assert notes["method"] == "look-and-press"


def test_nobody_in_the_picture_ends_the_trial_with_the_reason(session: MakeSession) -> None:
    sent, notes = run(Plant(lambda place: -1.0), session(), observe(None))
    assert [action.done for action in sent] == [True]
    assert "found in the image" in str(notes["ended_without_touching"])
