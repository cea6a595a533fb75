"""One settled world for the checks of a module."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.episode.randomization import World, settled_world
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.sim.simulation import Simulation


@pytest.fixture(scope="package")
def built() -> tuple[World, np.ndarray]:
    """The world of T1-s000, and its state."""
    world = settled_world(load_protocol(), task_id="T1", seed=0)
    return world, world[0].integration_state()


@pytest.fixture
def same_world(built: tuple[World, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every check has the same world, which takes a second to build."""
    (simulation, settled, sha256), state = built

    def again(protocol: Protocol, *, task_id: str, seed: int) -> World:
        fresh = Simulation(simulation.scene)
        fresh.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return fresh, settled, sha256

    monkeypatch.setattr("carecontact.running.check.settled_world", again)
