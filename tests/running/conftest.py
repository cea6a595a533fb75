"""One settled world for the trials and checks of this folder."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from carecontact.episode.randomization import World, settled_world
from carecontact.protocol.load import load_protocol
from carecontact.sim.simulation import Simulation


@pytest.fixture(scope="package")
def again() -> Callable[..., World]:
    """Gives the world of T1-s000, which takes a second to build, as it was when it had settled."""
    simulation, settled, sha256 = settled_world(load_protocol("bathing-v3"), task_id="T1", seed=0)
    state = simulation.integration_state()

    def restored(*_: object, **__: object) -> World:
        fresh = Simulation(simulation.scene)
        fresh.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return fresh, settled, sha256

    return restored


@pytest.fixture
def same_world(again: Callable[..., World], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every check has the same world."""
    monkeypatch.setattr("carecontact.running.check.settled_world", again)
