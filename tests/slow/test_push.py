"""The push moves the wrist because the arm is passive: the same commands on a locked arm move nothing."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.trial import TrialSpec
from carecontact.episode.randomization import comfort_arm_deg
from carecontact.protocols import load_protocol
from carecontact.recording import Recording
from carecontact.scoring import score_recording
from carecontact.sim.impedance import steps_of_period
from carecontact.sim.simulation import Simulation
from carecontact.trials.trial import run_trial
from carecontact.world.scene import build_scene

pytestmark = pytest.mark.slow
SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def pushes() -> list[Recording]:
    protocol = load_protocol()
    return [run_trial(TrialSpec(protocol=protocol, task_id="T2", seed=s, policy="state-machine")) for s in SEEDS]


def test_wrist_moves_in_two_of_three_seeds(pushes: list[Recording]) -> None:
    moved = [score_recording(r).wrist_displacement_any_m for r in pushes]
    assert sum(m >= 0.020 for m in moved) >= 2, moved


@pytest.mark.parametrize("index", range(len(SEEDS)))
def test_locked_arm_stays(pushes: list[Recording], index: int) -> None:
    recording = pushes[index]
    simulation = Simulation(build_scene(load_protocol(), target="forearm", skin=False))
    simulation.settle(comfort_arm_deg(simulation.protocol, SEEDS[index]))
    model = simulation.model
    for name in simulation.joint_names:
        if name.startswith("right_"):
            model.dof_damping[model.joint(f"human_{name}").dofadr[0]] = 1e6
    wrist = model.body("human_right_hand").id
    simulation.start()
    before = simulation.data.xpos[wrist].copy()
    assert recording.header.card is not None
    rate = float(recording.header.card["control_hz"])
    poses, periods = recording["actions/pose_tcp_in_base"], steps_of_period(rate, model.opt.timestep)
    moved, peak = 0.0, 0.0
    for pose in poses:
        simulation.set_goal(pose if np.isfinite(pose).all() else None, 1 / rate)
        for samples in simulation.advance(next(periods)):
            peak = max(peak, float(np.linalg.norm(samples.force, axis=2).max()))
        moved = max(moved, float(np.linalg.norm((simulation.data.xpos[wrist] - before)[:2])))
    assert peak > 8.0, "the locked arm must have been pushed"
    assert moved <= 0.002
