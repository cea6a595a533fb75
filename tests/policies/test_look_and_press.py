"""Look-and-press before the synthetic person, on a plant of one spring, one damper and a skin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from carecontact.interface.action import Action
from carecontact.interface.action_spaces import check_action, clip_action
from carecontact.interface.body_view import region_from_observation
from carecontact.interface.observation import Observation
from carecontact.interface.robot import Session
from carecontact.policies.look_and_press import MISSED_M, MOVED_M, WASH_N, LookAndPress
from carecontact.policies.motion import CONTROL_HZ
from carecontact.policies.pressing import FORCE_N, HELD_N, SOFT, STIFFNESS
from carecontact.policies.state_machine import StateMachine
from carecontact.protocol.sections import FOAM_COLOURS
from tests.interface.lying_person import LIMB_RADIUS, Person, observe
from tests.policies.test_foam import foamed
from tests.policies.test_mean_person_force import STEPS, Plant, held_n

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
    assert held_n(plant) == pytest.approx(FORCE_N, abs=0.4)
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
    assert looks(sent) == presses, "it looks after each"


def test_skin_that_is_not_there_is_not_followed_down(observation: Observation, session: MakeSession) -> None:
    plant = Plant(lambda place: -1.0)
    lowest: list[float] = []
    step = plant.step
    plant.step = lambda action: (step(action), lowest.append(float(plant.pose[2])))[0]
    sent, _ = run(plant, session(), observation)
    assert SKIN_M - MISSED_M - 0.02 < min(lowest) < SKIN_M - 0.5 * MISSED_M
    assert sent[-1].done


def spied(plant: Plant, change: Callable[[], None] = lambda: None) -> list[np.ndarray]:
    """Call ``change`` after every control period of a plant; return where the tool is after each, and its target."""
    found, step = list[np.ndarray](), plant.step

    def stepped(action: Action) -> None:
        step(action)
        change()
        found.append(np.array([plant.pose[:3], plant.target[:3]]))

    plant.step = stepped
    return found


def test_a_tool_that_is_held_is_not_pulled_on_but_lifted_and_tried_again(
    observation: Observation, session: MakeSession
) -> None:
    held, end = Plant(lambda place: SKIN_M), region_from_observation(observation, "forearm").centre_m[0] + 0.01

    def wall() -> None:
        if held.pose[2] < SKIN_M + 0.01:
            held.pose[0] = min(held.pose[0], end)

    ways = spied(held, wall)
    sent, _ = run(held, session(), observation, prompt=SCRUB)
    pulled = max(abs(target[0] - place[0]) for place, target in ways if place[2] < SKIN_M + 0.01)
    assert STIFFNESS * pulled < HELD_N + 4.0, "no more than a control period's way beyond the limit"
    touching = np.array(held.forces) > 0.1
    assert np.count_nonzero(np.diff(touching.astype(int)) == 1) == 2
    assert looks(sent) == 1, "after the second try there is no time for a third"
    assert len(sent) < 30 * CONTROL_HZ


def test_a_person_who_moves_into_the_tool_does_not_meet_an_arm_that_stays(
    observation: Observation, session: MakeSession
) -> None:
    rises_m, skin_m = 0.15 / CONTROL_HZ, [SKIN_M]

    def rise() -> None:
        skin_m[0] += rises_m * (len(plant.forces) > 11 * CONTROL_HZ * STEPS and skin_m[0] < SKIN_M + 0.08)

    plant = Plant(lambda place: skin_m[0])
    ways = spied(plant, rise)
    sent, _ = run(plant, session(), observation, prompt=SCRUB)
    begins = int(11 * CONTROL_HZ)
    lifted = next(k for k, (_, target) in enumerate(ways) if k > begins and target[2] > ways[begins][1][2] + 0.01)
    assert lifted < begins + 0.5 * CONTROL_HZ
    assert looks(sent) >= 1


def test_a_tool_that_slides_off_the_limb_does_not_follow_what_is_beside_it(
    observation: Observation, session: MakeSession
) -> None:
    end = region_from_observation(observation, "forearm").centre_m[0] + 0.01
    plant = Plant(lambda place: SKIN_M if place[0] < end else -1.0)
    ways = spied(plant)
    sent, _ = run(plant, session(), observation, prompt=SCRUB)
    assert min(place[2] for place, _ in ways) > SKIN_M - 0.045
    assert looks(sent) >= 1


@pytest.mark.parametrize("left", [False, True])
def test_foam_that_a_later_look_still_shows_is_washed_again(
    observation: Observation, session: MakeSession, left: bool
) -> None:
    forearm = region_from_observation(observation, "forearm")
    first = foamed(observation, forearm, FOAM_COLOURS["lime"], half_m=(0.03, 0.01))
    plant = Plant(lambda place: SKIN_M)
    prompt = "gently scrub the foam off the right forearm"
    _, notes = run(plant, session(), first, later=first if left else observation, prompt=prompt)
    touching = np.array(plant.forces) > 0.1
    assert np.count_nonzero(np.diff(touching.astype(int)) == 1) == 1 + left
    assert left or "no foam is seen" in str(notes["ended_because"])


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
