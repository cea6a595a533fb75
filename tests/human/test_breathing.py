"""The trunk's slides in a whole world, and the visible skin that rides on them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree

from carecontact.human.body import Body
from carecontact.human.breathing import SIDE_M, breath_body, shares
from carecontact.human.hulls import parted, plate_body
from carecontact.human.shell import belly_half_width, belly_span
from carecontact.human.skeleton import body_name
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.person import Alive, Breathing, Repositioning
from carecontact.protocol.protocol import Protocol
from carecontact.sim.state import skin_in_world
from carecontact.tissue.life import PARTS, Life
from carecontact.world.scene import Scene, build_scene


def living(alive: Alive, protocol: Protocol | None = None) -> Protocol:
    protocol = protocol or load_protocol("bathing-v3")
    return protocol.model_copy(update={"person": protocol.person.model_copy(update={"alive": alive})})


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(living(Alive(breathing=Breathing())), target=None, skin=False)


@pytest.fixture(scope="module")
def heavy() -> Scene:
    rules = overridden(load_protocol("bathing-v3"), {"person.body": "man-old-heavy"})
    return build_scene(living(Alive(breathing=Breathing()), rules), target="abdomen")


def skin_at(scene: Scene, abdomen_m: float, chest_m: float) -> np.ndarray:
    data = mujoco.MjData(scene.model)
    for part, value in zip(PARTS, (abdomen_m, chest_m), strict=True):
        data.joint(breath_body(part)).qpos[:] = value
    mujoco.mj_kinematics(scene.model, data)
    return skin_in_world(scene.model, data)


def test_the_back_does_not_breathe_and_the_middle_of_the_belly_does(body: Body) -> None:
    share = shares(body, body.vertices)
    moved = share["abdomen"] + share["chest"]
    assert moved.max() <= 1.0 + 1e-9
    assert moved[body.vertices[:, 1] > body.joint_centre["thorax"][1]].max() == 0.0
    low, high = belly_span(body)
    middle = np.array([[0.0, body.vertices_of("abdomen")[:, 1].min(), (low + high) / 2]])
    assert shares(body, middle)["abdomen"] == pytest.approx(1.0)
    assert belly_half_width(body) > 0.08


def test_the_region_and_its_frame_ride_on_the_slide_and_its_core_stays(scene: Scene) -> None:
    model = scene.model
    slide, floor = (model.body(name).id for name in (breath_body("abdomen"), plate_body("belly_floor")))
    assert model.site("region_abdomen").bodyid == slide
    cores = [g for g in range(model.ngeom) if model.geom(g).name.startswith("human_core_abdomen")]
    assert cores
    assert {int(model.geom_bodyid[g]) for g in cores} == {floor}


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
    still = build_scene(load_protocol("bathing-v3"), target="forearm", skin=False).model
    assert not Life.exists(still)
    assert {still.actuator(k).name.partition("_")[0] for k in range(still.nu)} == {"impedance"}
    assert {still.body(k).name for k in range(still.nbody)}.isdisjoint({breath_body(p) for p in PARTS})
    assert still.nplugin == len(load_protocol("bathing-v3").soft_regions)


def test_only_what_is_asked_for_is_built() -> None:
    moving = build_scene(living(Alive(repositioning=Repositioning())), target=None, skin=False).model
    assert Life.exists(moving)
    assert {moving.actuator(k).name.partition("_")[0] for k in range(moving.nu)} == {"impedance", "holds", "turns"}
    breathing = build_scene(living(Alive(breathing=Breathing())), target=None, skin=False).model
    assert {breathing.actuator(k).name.partition("_")[0] for k in range(breathing.nu)} == {"impedance", "breathes"}


def skin_near(scene: Scene, points: np.ndarray) -> np.ndarray:
    """(n,) vertex of the visible skin nearest to each point (n, 3) of the bind pose."""
    return cKDTree(np.asarray(scene.model.skin_vert, np.float64).reshape(-1, 3)).query(points)[1]


def test_all_skin_over_a_heavy_belly_moves_as_far_as_the_region(heavy: Scene) -> None:
    moved = np.linalg.norm(skin_at(heavy, 0.015, 0.005) - skin_at(heavy, 0.0, 0.0), axis=1)
    shell = heavy.regions["abdomen"].shell
    np.testing.assert_allclose(moved[skin_near(heavy, shell.vertices)], 0.015, atol=5e-4)
    np.testing.assert_allclose(moved[skin_near(heavy, shell.vertices[shell.fine])], 0.015, atol=1e-4)


def test_skin_over_a_heavy_chest_moves_with_the_plates_and_nothing_beside_them(heavy: Scene) -> None:
    moved = np.linalg.norm(skin_at(heavy, 0.0, 0.005) - skin_at(heavy, 0.0, 0.0), axis=1)
    bind, body = np.asarray(heavy.model.skin_vert, np.float64).reshape(-1, 3), heavy.body
    chest = parted(body)["right_chest"]
    _, high = belly_span(body)
    front = chest[(chest[:, 1] < body.joint_centre["thorax"][1] - SIDE_M) & (chest[:, 2] > high + 0.05)]
    on_body = front[cKDTree(body.vertices).query(front)[0] < 1e-9]
    assert len(on_body) > 50
    nearest = skin_near(heavy, on_body)
    np.testing.assert_allclose(moved[nearest], 0.005, atol=9e-4)
    assert np.median(moved[nearest]) == pytest.approx(0.005, abs=1e-5)
    assert moved[bind[:, 1] > body.joint_centre["thorax"][1]].max() < 1e-6
    arms = [body.segments.index(s) for s in body.segments if s.endswith(("arm", "hand", "head"))]
    still = body.vertices[(body.weight.max(1) > 0.99) & np.isin(body.owner, arms)]
    assert moved[skin_near(heavy, still)].max() < 1e-4


def test_skin_lies_as_it_did_while_nothing_is_breathed(heavy: Scene) -> None:
    rules = overridden(load_protocol("bathing-v3"), {"person.body": "man-old-heavy"})
    still = build_scene(rules, target="abdomen")
    data = mujoco.MjData(still.model)
    mujoco.mj_kinematics(still.model, data)
    np.testing.assert_allclose(skin_at(heavy, 0.0, 0.0), skin_in_world(still.model, data), atol=1e-5)
    assert heavy.model.body(heavy.model.body(plate_body("belly_floor")).parentid[0]).name == body_name("abdomen")


def test_the_share_of_a_breath_fades_nowhere_over_what_a_tool_feels_of_it(body: Body) -> None:
    low, high = belly_span(body)
    half_width = belly_half_width(body)
    ahead = body.joint_centre["thorax"][1] - SIDE_M
    rim = np.array([[x, ahead, z] for x in (-half_width, half_width) for z in (low, high)])
    aside = rim * [1.1, 1.0, 1.0]
    np.testing.assert_allclose(shares(body, rim)["abdomen"], 1.0)
    np.testing.assert_allclose(shares(body, aside)["abdomen"], 1.0)
