from __future__ import annotations

from collections.abc import Callable

import pytest

from carecontact.episode.randomization import World, settled_world
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.sim.simulation import Simulation


@pytest.fixture(scope="session")
def t1() -> TrialSpec:
    return TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="blind")


@pytest.fixture(scope="session")
def parked_world() -> Callable[[TrialSpec], World]:
    """The same settled world of T1 for every episode."""
    simulation, settled, sha256 = settled_world(load_protocol("bathing-v3"), task_id="T1", seed=0)
    state = simulation.integration_state()

    def prepare(spec: TrialSpec) -> World:
        fresh = Simulation(simulation.scene)
        fresh.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return fresh, settled, sha256

    return prepare
