"""Random targets that reach far under the skin: no divergence, no solver warning, no more force than the robot has.

``CARECONTACT_HAMMERINGS`` is the number of trials of the slow test, 1,000 if it is not set; at least a tenth of them
meet the skin with the hand's flank.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from carecontact.episode import randomization as stored
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.interface.robot import PANDA
from carecontact.lab.validation.subject import DOWN, in_base, skin_points
from carecontact.protocol.load import load_protocol
from carecontact.sim.simulation import Settled, Simulation
from carecontact.system import CACHE_VARIABLE
from carecontact.world.scene import Scene, build_scene
from tests.sim.conftest import COMFORT_ARM_DEG

TRIAL_S, NEW_TARGET_S, PART_STEPS = 5.0, 0.5, 50
BELOW_SKIN_M, ABOVE_SKIN_M, SIDE_M = 0.040, 0.060, 0.080
COUNT = int(os.environ.get("CARECONTACT_HAMMERINGS", "1000"))
FLANK = np.array([0.5, 0.5, 0.5, 0.5])
"""quat_wxyz of a hand that lies level, one flank down."""


@dataclass
class Hammering:
    peak_n: float = 0.0
    """Largest force of all contacts with one segment."""
    tissue_n: float = 0.0
    """Largest force of one soft region."""
    bound_n: float = 0.0
    """What that force may be."""


def hammer(
    simulation: Simulation, start: np.ndarray, region: str, rng: np.random.Generator, *, flank: bool
) -> Hammering:
    """One trial of random targets at the highest stiffness."""
    simulation.restore(start, comfort_arm_deg=COMFORT_ARM_DEG)
    impedance = simulation.protocol.impedance
    simulation.set_stiffness(impedance.translational_bounds[1], impedance.rotational_bounds[1])
    model, data = simulation.model, simulation.data
    skin = skin_points(simulation, region)
    middle = data.site(f"region_{region}").xpos
    top = skin[np.linalg.norm(skin[:, :2] - middle[:2], axis=1) < 0.03][:, 2].max()
    low = np.array([*(middle[:2] - SIDE_M), top - BELOW_SKIN_M])
    high = np.array([*(middle[:2] + SIDE_M), top + ABOVE_SKIN_M])
    turned = FLANK if flank else DOWN
    # From the parked pose to over the box, then the trial proper.
    simulation.set_goal(np.r_[in_base(simulation, np.array([*middle[:2], top + 0.10])), turned], 1.0)
    simulation.advance(1500)
    found, speed, area, depth = Hammering(), 0.0, 0.0, 0.0
    mass = _heaviest_kg(simulation)
    for _ in range(round(TRIAL_S / NEW_TARGET_S)):
        simulation.set_goal(np.r_[in_base(simulation, rng.uniform(low, high)), turned], 0.02)
        for _ in range(round(NEW_TARGET_S / model.opt.timestep / PART_STEPS)):
            for samples in simulation.advance(PART_STEPS):
                assert np.isfinite(samples.force).all()
                found.peak_n = max(found.peak_n, float(np.linalg.norm(samples.force, axis=2).max()))
                speed = max(speed, float(samples.tcp_speed.max()))
            for felt in simulation.tissue.values():
                rows = felt.last(data, PART_STEPS)
                found.tissue_n = max(found.tissue_n, float(np.linalg.norm(rows["force_n"], axis=1).max()))
                area, depth = max(area, float(rows["area_m2"].max())), max(depth, float(rows["depth_m"].max()))
        assert np.isfinite(data.qpos).all()
        assert np.isfinite(data.plugin_state).all()
        assert simulation.solver_warnings() == []
    stiffest = max(_stiffness_n_m(simulation, name, area, depth) for name in simulation.tissue)
    clamp = np.sqrt(3) * impedance.force_clamp_n
    found.bound_n = float(clamp + speed * np.sqrt(stiffest * mass))
    return found


def _heaviest_kg(simulation: Simulation) -> float:
    """The robot's effective mass at its tip (Khatib 1987), in the direction in which it is largest."""
    model, data = simulation.model, simulation.data
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(PANDA.tcp_site).id)
    mobility = np.zeros_like(jacobian)
    mujoco.mj_solveM(model, data, mobility, jacobian)
    return 1.0 / float(np.linalg.eigvalsh(jacobian @ mobility.T).min())


def _stiffness_n_m(simulation: Simulation, region: str, area_m2: float, depth_m: float) -> float:
    """At most: anchors as stiff as at that depth under all that touches and a coupling length around it, in series with
    the contact layer. A mass m that such a spring k stops from the speed v adds v sqrt(k m) to what pushes it."""
    t = simulation.scene.regions[region].tissue
    anchors = t.a_n_m3 + 2 * max(t.b_n_m4, 0.0) * depth_m + 3 * t.c_n_m5 * depth_m**2
    assert t.contact_n_m3 is not None
    wide = np.sqrt(area_m2 / np.pi) + t.coupling_length_m
    return float(np.pi * wide**2 / (1 / anchors + 1 / t.contact_n_m3))


def hammered(region: str, count: int, *, flank: bool = False) -> list[Hammering]:
    simulation = Simulation(build_scene(load_protocol("bathing-v3"), target=region, skin=False))
    simulation.settle(COMFORT_ARM_DEG)
    start = simulation.integration_state()
    rng = np.random.default_rng([STANDARD_REGIONS.index(region), 7, flank])
    out = [hammer(simulation, start, region, rng, flank=flank) for _ in range(count)]
    for found in out:
        assert found.tissue_n <= found.bound_n
    return out


def test_a_hammering_leaves_the_world_whole() -> None:
    found = hammered("forearm", 1)[0]
    assert 5.0 < found.tissue_n
    assert found.bound_n < 1000.0, "a bound that binds"


@pytest.mark.slow
@pytest.mark.parametrize("flank", [False, True], ids=["tool", "flank"])
@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_many_hammerings(region: str, flank: bool) -> None:
    """Half of them at least must press harder than 5 N, or the test would prove little."""
    count = ceil(COUNT * (0.1 if flank else 0.9) / len(STANDARD_REGIONS))
    found = hammered(region, count, flank=flank)
    bounds = [one.bound_n for one in found]
    sys.stdout.write(
        f"{region}: {count} trials, largest {max(one.tissue_n for one in found):.0f} N, bounds "
        f"{min(bounds):.0f} to {max(bounds):.0f} N, harder than 5 N {sum(one.tissue_n > 5.0 for one in found)}\n"
    )
    assert sum(one.tissue_n > 5.0 for one in found) >= count / 2


# Settled states kept on disk: the same as settling, and never trusted when anything differs.

ANGLE = 47.0


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path / "settled"


def forbidden(*_: object, **__: object) -> Settled:
    raise AssertionError("settled again")


def test_a_recalled_person_goes_on_as_the_one_that_settled(
    forearm_scene: Scene, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = forearm_scene.model_sha256
    first, second = Simulation(forearm_scene), None
    settled = stored.settle(first, ANGLE, model_sha256=key)
    went = np.concatenate([s.human_joint for s in first.advance(50)])
    monkeypatch.setattr(Simulation, "settle", forbidden)
    second = Simulation(forearm_scene)
    again = stored.settle(second, ANGLE, model_sha256=key)
    np.testing.assert_array_equal(np.concatenate([s.human_joint for s in second.advance(50)]), went)
    assert again.comfort_arm_deg == settled.comfort_arm_deg
    np.testing.assert_array_equal(again.joint_position, settled.joint_position)
    np.testing.assert_array_equal(again.wrist_in_world, settled.wrist_in_world)

    for other in ({"comfort_arm_deg": ANGLE + 1e-9}, {"model_sha256": "0" * 64}):
        with pytest.raises(AssertionError, match="settled again"):
            stored.settle(Simulation(forearm_scene), **{"comfort_arm_deg": ANGLE, "model_sha256": key, **other})


@pytest.mark.parametrize("damage", ["truncated", "empty", "changed", "foreign"])
def test_a_damaged_file_is_not_believed(forearm_scene: Scene, folder: Path, damage: str, fake_settle: Settled) -> None:
    key = forearm_scene.model_sha256
    stored.settle(Simulation(forearm_scene), ANGLE, model_sha256=key)
    (path,) = folder.iterdir()
    if damage == "changed":
        with np.load(path) as z:
            arrays = dict(z)
        arrays["state"] = arrays["state"] + 1e-12
        np.savez(path, **arrays)
    else:
        path.write_bytes({"truncated": path.read_bytes()[:500], "empty": b"", "foreign": b"not an archive"}[damage])
    assert stored.settle(Simulation(forearm_scene), ANGLE, model_sha256=key).duration_s == fake_settle.duration_s


@pytest.fixture
def fake_settle(forearm_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Settled:
    """Settling itself is others' business here: it does nothing and gives this."""
    made = Settled(
        duration_s=123.0, comfort_arm_deg=ANGLE, joint_position=np.zeros(3), wrist_in_world=np.array([0.1, 0.2, 0.3])
    )
    monkeypatch.setattr(Simulation, "settle", lambda self, angle: made)
    return made
