"""The world of one trial up to t = 0, for running it and for looking at it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, fields, replace

import numpy as np
import numpy.typing as npt

from carecontact.contract.control import Control
from carecontact.contract.protocol import Protocol
from carecontact.episode.drawn import draw
from carecontact.episode.randomization import dress, lay, soften, wake
from carecontact.kernel.region import Law
from carecontact.sim.settled import settle
from carecontact.sim.simulation import Settled, Simulation
from carecontact.world.scene import build_scene, controlled, copy_settings

World = tuple[Simulation, Settled, str]
"""A simulation at t = 0, how its person settled, and the sha256 of its model before dressing and settling."""


def settled_world(protocol: Protocol, *, task_id: str, seed: int, salt: str = "") -> World:
    """Build the task's world as the seed draws it, dress it, let the person settle, and give it the tissue and the life
    that the protocol varies with the seed. The simulation's protocol is the drawn one (``Drawn.protocol``).

    Args:
        salt: the trial's secret (``TrialSpec.salt``).

    Raises:
        SceneError: the world cannot be built, or no person of the seed suits the robot.
        SettleError: the person does not come to rest.
    """
    region = protocol.task(task_id).region
    drawn = draw(protocol, region=region, seed=seed, salt=salt)
    scene = replace(build_scene(drawn.protocol, target=region), place=drawn.place)
    # Hash the model before anything changes it: dressing, laying and settling write what the seed draws, and a policy
    # writes its stiffness.
    model_sha256 = scene.model_sha256
    dress(scene, seed, salt=salt)
    lay(scene, drawn.place)
    simulation = Simulation(scene)
    settled = settle(simulation, drawn.comfort_arm_deg, model_sha256=model_sha256)
    soften(simulation, seed, salt=salt)
    wake(simulation, seed, salt=salt)
    return simulation, settled, model_sha256


def under_control(simulation: Simulation, control: Control) -> tuple[Simulation, str]:
    """Put the robot of a world at t = 0 under a joint control, without another settling.

    Returns:
        The simulation of the world with that control, in the same state, and the sha256 of its model.
    """
    scene = controlled(simulation.scene, control)
    model_sha256 = scene.model_sha256
    copy_settings(simulation.model, scene.model)
    driven = Simulation(scene)
    driven.take_over(simulation)
    return driven, model_sha256


def constants_of(simulation: Simulation, settled: Settled) -> Mapping[str, npt.NDArray[np.float64]]:
    """Return arrays of a recording that hold for the whole trial, by their path."""
    return {
        "scorer/human_joint_range": simulation.joint_range.astype("<f8"),
        "scorer/human_joint_settled": settled.joint_position.astype("<f8"),
        "scorer/wrist_settled_in_world": settled.wrist_in_world.astype("<f8"),
        "scorer/region_size_m": simulation.scene.region_size_m.astype("<f8"),
        **_own_law(simulation),
    }


def _own_law(simulation: Simulation) -> dict[str, npt.NDArray[np.float64]]:
    """Return the compiled laws if any differs from its row in the protocol, by the body's build or by the seed's
    draw.
    """
    rows = simulation.protocol.person.tissue
    law = np.zeros((len(simulation.protocol.regions), len(fields(Law))))
    declared = law.copy()
    for at, name in enumerate(simulation.protocol.regions):
        if name in simulation.scene.regions:
            law[at] = simulation.model.numeric(f"{name}/law").data
            declared[at] = astuple(Law.of(rows[name]))
    return {} if np.array_equal(law, declared) else {"scorer/region_law": law.astype("<f8")}
