"""Random targets that reach far under the skin: no divergence, no solver warning."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.protocols import load_protocol
from carecontact.regions import STANDARD_REGIONS
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene

from .conftest import COMFORT_ARM_DEG, DOWN, in_base, surface

TRIAL_S, NEW_TARGET_S = 5.0, 0.5
BELOW_SKIN_M, ABOVE_SKIN_M, SIDE_M = 0.040, 0.060, 0.080


def hammer(simulation: Simulation, start: np.ndarray, region: str, rng: np.random.Generator) -> float:
    """One trial of random targets at the highest stiffness; returns the largest contact force [N]."""
    simulation.restore(start, comfort_arm_deg=COMFORT_ARM_DEG)
    simulation.set_stiffness(*(high for _, high in _stiffness_bounds(simulation)))
    model, data = simulation.model, simulation.data
    skin = surface(simulation, region)
    middle = data.site(f"region_{region}").xpos
    top = skin[np.linalg.norm(skin[:, :2] - middle[:2], axis=1) < 0.03][:, 2].max()
    low = np.array([*(middle[:2] - SIDE_M), top - BELOW_SKIN_M])
    high = np.array([*(middle[:2] + SIDE_M), top + ABOVE_SKIN_M])
    # From the parked pose to over the box, then the trial proper.
    simulation.set_goal(np.r_[in_base(simulation, [middle[0], middle[1], top + 0.10]), DOWN], 1.0)
    simulation.advance(1500)
    peak = 0.0
    for _ in range(round(TRIAL_S / NEW_TARGET_S)):
        simulation.set_goal(np.r_[in_base(simulation, rng.uniform(low, high)), DOWN], 0.02)
        for samples in simulation.advance(round(NEW_TARGET_S / model.opt.timestep)):
            assert np.isfinite(samples.force).all()
            peak = max(peak, float(np.linalg.norm(samples.force, axis=2).max()))
        assert np.isfinite(data.qpos).all()
        assert simulation.solver_warnings() == []
    return peak


def _stiffness_bounds(simulation: Simulation) -> list[tuple[float, float]]:
    impedance = simulation.protocol.impedance
    return [impedance.translational_bounds, impedance.rotational_bounds]


def hammered(region: str, count: int) -> list[float]:
    simulation = Simulation(build_scene(load_protocol(), target=region, skin=False))
    simulation.settle(COMFORT_ARM_DEG)
    start = simulation.integration_state()
    rng = np.random.default_rng([STANDARD_REGIONS.index(region), 7])
    return [hammer(simulation, start, region, rng) for _ in range(count)]


def test_a_hammering_leaves_the_world_whole() -> None:
    assert max(hammered("forearm", 1)) > 5.0


@pytest.mark.slow
def test_a_hundred_hammerings() -> None:
    """Half of them at least must press harder than 5 N, or the test would prove little."""
    peaks = [p for region, count in zip(STANDARD_REGIONS, (34, 33, 33), strict=True) for p in hammered(region, count)]
    assert len(peaks) == 100
    assert sum(p > 5.0 for p in peaks) >= 50
