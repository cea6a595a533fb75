"""The trunk's slides in a whole world, and the visible skin that rides on them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.contract.protocol import Alive, Breathing, Protocol, Repositioning
from carecontact.kernel.life import PARTS, Life
from carecontact.protocols import load_protocol
from carecontact.sim.true_skin import skin_in_world
from carecontact.world.human.body import Body
from carecontact.world.human.breathing import breath_body, shares
from carecontact.world.human.plates import plate_body
from carecontact.world.human.shell import belly_half_width, belly_span
from carecontact.world.scene import Scene, build_scene


def living(alive: Alive) -> Protocol:
    protocol = load_protocol()
    return protocol.model_copy(update={"person": protocol.person.model_copy(update={"alive": alive})})


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(living(Alive(breathing=Breathing())), target="abdomen")


def skin_at(scene: Scene, abdomen_m: float, chest_m: float) -> np.ndarray:
    data = mujoco.MjData(scene.model)
    for part, value in zip(PARTS, (abdomen_m, chest_m), strict=True):
        data.joint(breath_body(part)).qpos[:] = value
    mujoco.mj_kinematics(scene.model, data)
    return skin_in_world(scene.model, data)


def test_skin_over_the_belly_moves_with_the_region_and_the_chest_with_its_slide(scene: Scene) -> None:
    moved = np.linalg.norm(skin_at(scene, 0.015, 0.005) - skin_at(scene, 0.0, 0.0), axis=1)
    bind = np.asarray(scene.model.skin_vert, np.float64).reshape(-1, 3)
    shell = scene.regions["abdomen"].shell
    for vertex in shell.vertices[shell.fine][::20]:
        nearest = np.linalg.norm(bind - vertex, axis=1).argmin()
        assert moved[nearest] == pytest.approx(0.015, abs=1e-4)
    share = shares(scene.body, bind)
    np.testing.assert_allclose(moved, 0.015 * share["abdomen"] + 0.005 * share["chest"], atol=1e-4)
    assert (share["chest"] > 0.99).sum() > 50


def test_skin_lies_as_it_did_while_nothing_is_breathed(scene: Scene) -> None:
    still = build_scene(load_protocol(), target="abdomen")
    data = mujoco.MjData(still.model)
    mujoco.mj_kinematics(still.model, data)
    np.testing.assert_allclose(skin_at(scene, 0.0, 0.0), skin_in_world(still.model, data), atol=1e-5)


def test_back_arms_head_and_legs_do_not_breathe(body: Body) -> None:
    share = shares(body, body.vertices)
    moved = share["abdomen"] + share["chest"]
    assert moved.max() <= 1.0 + 1e-9
    still = [s for s in body.segments if s.endswith(("arm", "hand", "shank", "foot", "head"))]
    assert moved[np.isin(body.owner, [body.segments.index(s) for s in still])].max() < 0.3
    assert moved[body.vertices[:, 1] > body.joint_centre["thorax"][1]].max() == 0.0
    low, high = belly_span(body)
    middle = np.array([[0.0, body.vertices_of("abdomen")[:, 1].min(), (low + high) / 2]])
    assert shares(body, middle)["abdomen"] == pytest.approx(1.0)
    assert belly_half_width(body) > 0.08


def test_the_region_and_its_frame_ride_on_the_slide_and_its_core_stays(scene: Scene) -> None:
    model = scene.model
    slide, bone = model.body(breath_body("abdomen")).id, model.body("human_abdomen").id
    assert model.site("region_abdomen").bodyid == slide
    cores = [g for g in range(model.ngeom) if model.geom(g).name.startswith("human_core_abdomen")]
    assert cores
    assert {int(model.geom_bodyid[g]) for g in cores} == {bone}


def test_the_plates_of_the_chest_ride_on_its_slide(scene: Scene) -> None:
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_kinematics(model, data)
    chest, hip = (model.body(plate_body(f"right_{part}")).id for part in ("chest", "hip"))
    before = data.xpos.copy()
    data.joint(breath_body("chest")).qpos[:] = 0.004
    mujoco.mj_kinematics(model, data)
    moved = np.linalg.norm(data.xpos - before, axis=1)
    assert moved[chest] == pytest.approx(0.004)
    assert moved[hip] == 0.0


def test_a_person_that_does_nothing_has_none_of_it() -> None:
    still = build_scene(load_protocol(), target="forearm", skin=False).model
    assert not Life.exists(still)
    assert {still.actuator(k).name.partition("_")[0] for k in range(still.nu)} == {"impedance"}
    assert {still.body(k).name for k in range(still.nbody)}.isdisjoint({breath_body(p) for p in PARTS})
    assert still.nplugin == len(load_protocol().soft_regions)


def test_only_what_is_asked_for_is_built() -> None:
    moving = build_scene(living(Alive(repositioning=Repositioning())), target=None, skin=False).model
    assert Life.exists(moving)
    assert {moving.actuator(k).name.partition("_")[0] for k in range(moving.nu)} == {"impedance", "holds", "turns"}
    breathing = build_scene(living(Alive(breathing=Breathing())), target=None, skin=False).model
    assert {breathing.actuator(k).name.partition("_")[0] for k in range(breathing.nu)} == {"impedance", "breathes"}
