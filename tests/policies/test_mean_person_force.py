"""The blind arms that press with a force, against a plant of one spring, one damper and a skin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from carecontact.interface.action import Action
from carecontact.interface.action_spaces import check_action, clip_action
from carecontact.policies.mean_person import (
    MeanPersonEstimated,
    MeanPersonHybrid,
    MeanPersonPolicy,
    MeanPersonSearch,
    geometry_in_base,
    read_person,
)
from carecontact.policies.motion import CONTROL_HZ
from carecontact.policies.pressing import DAMPING_NS_M, FORCE_N, STIFFNESS
from tests.policies.synthetic import synthetic_observation, synthetic_view
from tests.policies.test_mean_person import CAMERA, PROTOCOL, _session

ARMS = [MeanPersonHybrid, MeanPersonEstimated, MeanPersonSearch]
TOUCH, PUSH, SCRUB = (task.prompt for task in PROTOCOL.tasks[:3])
FOREARM = geometry_in_base("forearm", read_person(None).regions["forearm"], CAMERA)
SKIN_N_M = 300.0
SOFT_DAMPING_NS_M = 2 * np.sqrt(PROTOCOL.impedance.translational_bounds[0] * PROTOCOL.impedance.effective_mass_kg)
"""Of an axis without stiffness (``sim.impedance.set_gains``)."""
STEPS = 25


@dataclass
class Plant:
    """A tool that the impedance moves without inertia."""

    height: Callable[[np.ndarray], float]
    """Place (2,) in base -> height of the skin there [m]."""
    bias_n: float = 0.0
    """Upward force beside what is commanded."""
    friction_n: float = 0.0

    def __post_init__(self) -> None:
        self.pose = np.array([0.5, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0])
        self.target, self.stiffness, self.feedforward = self.pose.copy(), np.full(3, STIFFNESS), 0.0
        self.forces: list[float] = []

    def step(self, action: Action) -> None:
        begin = self.target
        if action.pose_tcp_in_base is not None:
            self.target = action.pose_tcp_in_base
        if action.stiffness is not None:
            self.stiffness = np.array(action.stiffness[:3] if len(action.stiffness) == 6 else [action.stiffness[0]] * 3)
        if action.wrench_in_tcp is not None:
            self.feedforward = float(action.wrench_in_tcp[2])
        for share in np.linspace(0, 1, STEPS + 1)[1:]:
            target = begin[:3] + share * (self.target[:3] - begin[:3])
            skin = SKIN_N_M * max(0.0, self.height(self.pose[:2]) - float(self.pose[2]))
            force = self.stiffness * (target - self.pose[:3])
            # The tool points down, so that its feedforward does too.
            force[2] += skin + self.bias_n - self.feedforward
            moves = np.sign(force) * np.maximum(np.abs(force) - self.friction_n, 0.0)
            damping = np.where(self.stiffness > 0, DAMPING_NS_M, SOFT_DAMPING_NS_M)
            self.pose[:3] += moves / damping / CONTROL_HZ / STEPS
            self.forces.append(skin)
        self.pose[3:] = self.target[3:]


def run(arm: type[MeanPersonPolicy], plant: Plant, prompt: str = TOUCH) -> list[Action]:
    """Return every action of a trial, each of them valid; the last one ends it."""
    policy, session = arm(), _session()
    policy.configure(session)
    policy.reset(prompt)
    view = replace(synthetic_view(), pose_camera_in_base=CAMERA)
    sent: list[Action] = []
    while not (sent and sent[-1].done):
        seen = synthetic_observation(cameras={"overhead": view})
        for action in policy.act(replace(seen, pose_tcp_in_base=plant.pose.copy())):
            checked = check_action(clip_action(action, session.action_bounds), session.action_bounds)
            plant.step(checked)
            sent.append(action)
        assert len(sent) < 30 * CONTROL_HZ
    assert not any(action.done for action in sent[:-1])
    return sent


def flat(shift_m: float = 0.0) -> Callable[[np.ndarray], float]:
    return lambda place: float(FOREARM.centre_m[2]) + shift_m


def held_n(plant: Plant) -> float:
    """The middle of the forces while the skin is touched."""
    forces = np.array(plant.forces)
    return float(np.median(forces[forces > 0.1]))


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("shift_m", [-0.02, 0.0, 0.03])
def test_on_an_ideal_arm_the_force_is_right_wherever_the_skin_is(arm: type[MeanPersonPolicy], shift_m: float) -> None:
    plant = Plant(flat(shift_m))
    run(arm, plant)
    assert held_n(plant) == pytest.approx(FORCE_N, abs=0.4)
    assert max(plant.forces) < 7.0
    assert plant.forces[-1] == 0.0, "it has left"


def test_the_arm_without_force_does_not_find_a_skin_that_is_lower() -> None:
    plant = Plant(flat(-0.02))
    run(MeanPersonPolicy, plant)
    assert max(plant.forces) == 0.0


@pytest.mark.parametrize("bias_n", [-1.5, 1.0])
def test_a_bias_goes_into_feedforward_and_not_into_an_estimate_that_was_tared(bias_n: float) -> None:
    hybrid, estimated = Plant(flat(), bias_n=bias_n), Plant(flat(), bias_n=bias_n)
    run(MeanPersonHybrid, hybrid)
    run(MeanPersonEstimated, estimated)
    assert held_n(hybrid) == pytest.approx(FORCE_N - bias_n, abs=0.4)
    assert held_n(estimated) == pytest.approx(FORCE_N, abs=0.4)


def test_friction_is_not_taken_for_a_contact() -> None:
    plant = Plant(flat(-0.03), friction_n=1.5)
    run(MeanPersonEstimated, plant)
    assert held_n(plant) == pytest.approx(FORCE_N, abs=1.6)


def test_hybrid_is_soft_along_the_tool_only_while_it_presses() -> None:
    sent = run(MeanPersonHybrid, Plant(flat()))
    changes = [action for action in sent if action.stiffness is not None]
    assert [action.stiffness for action in changes] == [(400, 400, 0, 20, 20, 20), (400, 20)]
    assert [float(action.wrench_in_tcp[2]) for action in changes if action.wrench_in_tcp is not None] == [FORCE_N, 0.0]


@pytest.mark.parametrize("side", [-0.08, -0.04, 0.0, 0.04, 0.08])
def test_the_search_finds_a_limb_that_lies_beside_its_mean_place(side: float) -> None:
    """A limb of 50 mm in width on a board that is 80 mm lower."""
    lateral = FOREARM.lateral[:2]

    def limb(place: np.ndarray) -> float:
        across = float((place - FOREARM.centre_m[:2]) @ lateral)
        return float(FOREARM.centre_m[2]) - (0.0 if abs(across - side) < 0.025 else 0.08)

    found, straight = Plant(limb), Plant(limb)
    run(MeanPersonSearch, found)
    assert held_n(found) == pytest.approx(FORCE_N, abs=0.4)
    if side:
        run(MeanPersonEstimated, straight)
        assert max(straight.forces) == 0.0


def test_where_nothing_lies_the_search_ends_without_pressing() -> None:
    plant = Plant(flat(-0.3))
    run(MeanPersonSearch, plant)
    assert max(plant.forces) == 0.0


@pytest.mark.parametrize("arm", ARMS)
def test_a_scrub_keeps_its_force_over_the_whole_path_and_a_push_is_the_mean_persons(
    arm: type[MeanPersonPolicy],
) -> None:
    plant = Plant(flat())
    sent = run(arm, plant, SCRUB)
    xy = np.array([a.pose_tcp_in_base[:2] for a in sent if a.pose_tcp_in_base is not None])
    along = (xy - FOREARM.centre_m[:2]) @ (FOREARM.axis[:2] / np.linalg.norm(FOREARM.axis[:2]))
    assert np.ptp(along[np.abs((xy - FOREARM.centre_m[:2]) @ FOREARM.lateral[:2]) < 0.02]) > 0.1
    assert held_n(plant) == pytest.approx(FORCE_N, abs=0.6), "the mean skin is arched and this one is flat"
    pushes, mean = run(arm, Plant(flat(-0.3)), PUSH), run(MeanPersonPolicy, Plant(flat(-0.3)), PUSH)
    assert len(pushes) == len(mean)
    assert all(action.stiffness is None for action in pushes)
