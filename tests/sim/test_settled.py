"""Settled states kept on disk: the same as settling, and never trusted when anything differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.cache_folder import CACHE_VARIABLE
from carecontact.sim import settled as stored
from carecontact.sim.simulation import Settled, Simulation
from carecontact.world.scene import Scene

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
