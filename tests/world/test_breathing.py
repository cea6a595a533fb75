"""The trunk's slides in a whole world, and the visible skin that rides on them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.contract.protocol import Alive, Breathing, Protocol, Repositioning
from carecontact.kernel.life import PARTS, Life
from carecontact.protocols import load_protocol, overridden
from carecontact.sim.true_skin import skin_in_world
from carecontact.world.human.body import Body
from carecontact.world.human.breathing import SIDE_M, breath_body, shares
from carecontact.world.human.parting import parted
from carecontact.world.human.plates import plate_body
from carecontact.world.human.shell import belly_half_width, belly_span
from carecontact.world.human.skeleton import body_name
from carecontact.world.human.versions import BUILDS, Build
from carecontact.world.scene import Scene, build_scene


def living(alive: Alive, protocol: Protocol | None = None) -> Protocol:
    protocol = protocol or load_protocol()
    return protocol.model_copy(update={"person": protocol.person.model_copy(update={"alive": alive})})


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(living(Alive(breathing=Breathing())), target="abdomen")


@pytest.fixture(scope="module")
def newest() -> Scene:
    """man-old-heavy, of whom person-v1 shows 2.2 mm too little at the abdomen's rim and 2.7 mm on the chest."""
    rules = overridden(load_protocol("bathing-v3-draft"), {"person.body": "man-old-heavy"})
    return build_scene(living(Alive(breathing=Breathing()), rules), target="abdomen")


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
    share = shares(scene.body, bind, Build())
    np.testing.assert_allclose(moved, 0.015 * share["abdomen"] + 0.005 * share["chest"], atol=1e-4)
    assert (share["chest"] > 0.99).sum() > 50


def test_skin_lies_as_it_did_while_nothing_is_breathed(scene: Scene) -> None:
    still = build_scene(load_protocol(), target="abdomen")
    data = mujoco.MjData(still.model)
    mujoco.mj_kinematics(still.model, data)
    np.testing.assert_allclose(skin_at(scene, 0.0, 0.0), skin_in_world(still.model, data), atol=1e-5)


def test_back_arms_head_and_legs_do_not_breathe(body: Body) -> None:
    share = shares(body, body.vertices, Build())
    moved = share["abdomen"] + share["chest"]
    assert moved.max() <= 1.0 + 1e-9
    still = [s for s in body.segments if s.endswith(("arm", "hand", "shank", "foot", "head"))]
    assert moved[np.isin(body.owner, [body.segments.index(s) for s in still])].max() < 0.3
    assert moved[body.vertices[:, 1] > body.joint_centre["thorax"][1]].max() == 0.0
    low, high = belly_span(body)
    middle = np.array([[0.0, body.vertices_of("abdomen")[:, 1].min(), (low + high) / 2]])
    assert shares(body, middle, Build())["abdomen"] == pytest.approx(1.0)
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


def test_all_skin_over_the_newest_persons_belly_moves_as_far_as_the_region(newest: Scene) -> None:
    moved = np.linalg.norm(skin_at(newest, 0.015, 0.005) - skin_at(newest, 0.0, 0.0), axis=1)
    bind = np.asarray(newest.model.skin_vert, np.float64).reshape(-1, 3)
    nearest = [np.linalg.norm(bind - vertex, axis=1).argmin() for vertex in newest.regions["abdomen"].shell.vertices]
    np.testing.assert_allclose(moved[nearest], 0.015, atol=5e-4)


def test_skin_over_the_newest_persons_chest_moves_with_the_plates_and_nothing_beside_them(newest: Scene) -> None:
    moved = np.linalg.norm(skin_at(newest, 0.0, 0.005) - skin_at(newest, 0.0, 0.0), axis=1)
    bind, body = np.asarray(newest.model.skin_vert, np.float64).reshape(-1, 3), newest.body
    chest = parted(body)["right_chest"]
    _, high = belly_span(body)
    front = chest[(chest[:, 1] < body.joint_centre["thorax"][1] - SIDE_M) & (chest[:, 2] > high + 0.05)]
    on_body = front[[bool((np.linalg.norm(body.vertices - p, axis=1) < 1e-9).any()) for p in front]]
    assert len(on_body) > 50
    nearest = [np.linalg.norm(bind - point, axis=1).argmin() for point in on_body]
    np.testing.assert_allclose(moved[nearest], 0.005, atol=9e-4)
    assert np.median(moved[nearest]) == pytest.approx(0.005, abs=1e-5)
    assert moved[bind[:, 1] > body.joint_centre["thorax"][1]].max() < 1e-6
    whole = body.weight.max(1) > 0.99
    arms = [s for s in body.segments if s.endswith(("arm", "hand", "head"))]
    for vertex in body.vertices[whole & np.isin(body.owner, [body.segments.index(s) for s in arms])]:
        assert moved[np.linalg.norm(bind - vertex, axis=1).argmin()] < 1e-4


def test_the_newest_persons_skin_lies_as_it_did_while_nothing_is_breathed(newest: Scene) -> None:
    rules = overridden(load_protocol("bathing-v3-draft"), {"person.body": "man-old-heavy"})
    still = build_scene(rules, target="abdomen")
    data = mujoco.MjData(still.model)
    mujoco.mj_kinematics(still.model, data)
    np.testing.assert_allclose(skin_at(newest, 0.0, 0.0), skin_in_world(still.model, data), atol=1e-5)
    assert newest.model.body(newest.model.body(plate_body("belly_floor")).parentid[0]).name == body_name("abdomen")


def test_the_share_of_a_breath_fades_nowhere_over_what_a_tool_feels_of_it(body: Body) -> None:
    """Of person-v1, the share at the rim is as low as 0.9."""
    low, high = belly_span(body)
    half_width, newest = belly_half_width(body), BUILDS["person-v2"]
    ahead = body.joint_centre["thorax"][1] - SIDE_M
    rim = np.array([[x, ahead, z] for x in (-half_width, half_width) for z in (low, high)])
    aside = rim * [1.1, 1.0, 1.0]
    np.testing.assert_allclose(shares(body, rim, newest)["abdomen"], 1.0)
    np.testing.assert_allclose(shares(body, aside, newest)["abdomen"], 1.0)
    assert shares(body, aside, Build())["abdomen"].min() < 0.95
