"""Energy of the person against MuJoCo's own sums and against a fall by hand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.validation.energy import Energy
from carecontact.validation.subject import Subject


def test_energy_differences_are_mujocos(subject: Subject) -> None:
    """Changes of potential and of kinetic energy, person only: the robot stays where it is in both states."""
    simulation = subject.at_rest("forearm")
    model, data = simulation.model, simulation.data
    rng = np.random.default_rng(3)
    robot = [model.joint(f"robot_joint{i}").dofadr[0] for i in range(1, 8)]
    data.qvel[robot] = 0.0
    energy, own, theirs = Energy(simulation), [], []
    for scale in (0.0, 1.0):
        data.qvel[energy.dof] = scale * rng.normal(0, 0.1, int(energy.dof.sum()))
        hinges = [model.joint(f"human_{name}").qposadr[0] for name in simulation.joint_names]
        data.qpos[hinges] += scale * rng.normal(0, 0.02, len(hinges))
        own.append(energy())
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        theirs.append(data.energy.sum())
    assert theirs[1] - theirs[0] > 0.01
    assert own[1] - own[0] == pytest.approx(theirs[1] - theirs[0], rel=1e-5)


def test_lifting_the_person_stores_its_weight(subject: Subject) -> None:
    simulation = subject.at_rest("forearm")
    simulation.data.qvel[:] = 0.0
    energy = Energy(simulation)
    before = energy()
    simulation.data.qpos[simulation.model.joint("human_root").qposadr[0] + 2] += 0.1
    weight = simulation.scene.body.mass_kg * 9.81
    assert energy() - before == pytest.approx(0.1 * weight, rel=1e-5)
