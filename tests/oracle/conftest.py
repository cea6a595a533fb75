from __future__ import annotations

import pytest

from carecontact.episode.randomization import settled_world
from carecontact.protocol.load import load_protocol
from carecontact.sim.simulation import Simulation


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    """Of the forearm's touch, settled; tests only read it."""
    found, _, _ = settled_world(load_protocol("bathing-v3"), task_id="T1", seed=0)
    found.start()
    found.refresh()
    return found
