"""A person who lies elsewhere lies there as before: on the bed, the arm on its board."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.cache_folder import CACHE_VARIABLE
from carecontact.sim import settled as stored
from carecontact.sim.simulation import Simulation
from carecontact.world.furniture import SUPPORT
from carecontact.world.place import Place, move_person
from carecontact.world.scene import Scene
from tests.sim.conftest import COMFORT_ARM_DEG

PLACE = Place(along_m=0.04, across_m=-0.03, yaw_deg=-5.0)


def elsewhere(scene: Scene, place: Place) -> Scene:
    moved = replace(scene, model=copy.copy(scene.model))
    move_person(moved.model, place)
    return moved


@pytest.fixture(scope="module")
def moved(forearm_scene: Scene) -> Simulation:
    simulation = Simulation(elsewhere(forearm_scene, PLACE))
    simulation.settle(COMFORT_ARM_DEG)
    simulation.refresh()
    return simulation


def on_board(simulation: Simulation, body: str) -> np.ndarray:
    """Origin of a body in the frame that moves with the person (3,)."""
    support, data = simulation.data.body(SUPPORT), simulation.data
    return support.xmat.reshape(3, 3).T @ (data.body(body).xpos - support.xpos)


@pytest.mark.parametrize("body", ["human_right_hand", "human_right_forearm", "human_head", "human_pelvis"])
def test_the_person_settles_as_in_the_protocols_place(moved: Simulation, settled: Simulation, body: str) -> None:
    settled.refresh()
    np.testing.assert_allclose(on_board(moved, body), on_board(settled, body), atol=0.003)
    assert moved.comfort_arm_deg() == pytest.approx(settled.comfort_arm_deg(), abs=0.3)
    away = moved.data.body(body).xpos - settled.data.body(body).xpos
    assert np.linalg.norm(away[:2]) > 0.02


def test_the_arm_rests_on_the_board_that_moved(moved: Simulation) -> None:
    board = moved.model.geom("bed_armboard").id
    met = {moved.model.geom(int(g)).name for c in moved.data.contact for g in c.geom if board in c.geom}
    assert {"human_proxy_right_elbow", "human_proxy_right_wrist"} <= met


def test_robot_bed_and_cameras_stay(moved: Simulation, settled: Simulation) -> None:
    np.testing.assert_array_equal(moved.pose_base_in_world, settled.pose_base_in_world)
    for name in ("bed_mattress", "bed_head"):
        np.testing.assert_array_equal(moved.data.geom(name).xpos, settled.data.geom(name).xpos)
    np.testing.assert_array_equal(moved.data.camera("overhead").xpos, settled.data.camera("overhead").xpos)


def test_a_stored_person_is_not_taken_for_one_who_lies_elsewhere(
    forearm_scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All have the compiled model's hash, so that their scores pool: the place alone must tell them apart."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    asked: list[Simulation] = []
    real = stored.Settled(
        duration_s=2.0, comfort_arm_deg=50.0, joint_position=np.zeros(3), wrist_in_world=np.zeros(3)
    )  # fmt: skip
    monkeypatch.setattr(Simulation, "settle", lambda self, angle: asked.append(self) or real)
    places = [Place(), PLACE, replace(PLACE, yaw_deg=-4.99), replace(PLACE, along_m=0.0), PLACE]
    for place in places:
        stored.settle(Simulation(elsewhere(forearm_scene, place)), 50.0, model_sha256="0" * 64)
    assert len(asked) == 4, "the last is the second again"
