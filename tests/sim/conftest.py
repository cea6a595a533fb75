from __future__ import annotations

import numpy as np
import pytest

from carecontact.lab.validation.subject import move_to, skin_points
from carecontact.protocol.load import load_protocol
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import Scene, build_scene

COMFORT_ARM_DEG = 52.5


@pytest.fixture(scope="session")
def forearm_scene() -> Scene:
    return build_scene(load_protocol("bathing-v3"), target="forearm", skin=False)


@pytest.fixture(scope="session")
def settled_state(forearm_scene: Scene) -> tuple[np.ndarray, float]:
    """Integration state after settling at 52.5 deg, and how long that took."""
    simulation = Simulation(forearm_scene)
    settled = simulation.settle(COMFORT_ARM_DEG)
    return simulation.integration_state(), settled.duration_s


@pytest.fixture
def settled(forearm_scene: Scene, settled_state: tuple[np.ndarray, float]) -> Simulation:
    """A simulation at t = 0 with the robot parked; each test has its own data."""
    simulation = Simulation(forearm_scene)
    simulation.restore(settled_state[0], comfort_arm_deg=COMFORT_ARM_DEG)
    return simulation


@pytest.fixture(scope="session")
def pressing_state(forearm_scene: Scene, settled_state: tuple[np.ndarray, float]) -> np.ndarray:
    """Integration state with the tool resting on the forearm at about 6 N."""
    simulation = Simulation(forearm_scene)
    simulation.restore(settled_state[0], comfort_arm_deg=COMFORT_ARM_DEG)
    top = top_of_forearm(simulation)
    move_to(simulation, top + [0, 0, 0.10], seconds=4.0)
    move_to(simulation, top - [0, 0, 0.02], seconds=3.0)
    simulation.advance(500)
    return simulation.integration_state()


@pytest.fixture
def pressing(forearm_scene: Scene, pressing_state: np.ndarray) -> Simulation:
    simulation = Simulation(forearm_scene)
    simulation.restore(pressing_state, comfort_arm_deg=COMFORT_ARM_DEG)
    return simulation


def top_of_forearm(simulation: Simulation) -> np.ndarray:
    """Surface point over the region's middle (3,)."""
    points, middle = skin_points(simulation, "forearm"), simulation.data.site("region_forearm").xpos
    near = points[np.linalg.norm(points[:, :2] - middle[:2], axis=1) < 0.015]
    return np.array([middle[0], middle[1], near[:, 2].max()])
