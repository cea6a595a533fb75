"""Plates: the segment keeps its mass, each plate swings as slowly as the fast mode can follow, and the
person has the plates that are declared."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.protocols import FAST_DT_S, load_protocol
from carecontact.world.human.anthropometry import SegmentInertia, segment_inertias
from carecontact.world.human.library import load_body
from carecontact.world.human.plates import (
    ARM,
    BELLY_FLOOR,
    FLOOR_GIVE,
    GIVES,
    PLATES,
    SIZE_M,
    plate_body,
    plates_of,
    without_plates,
)
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import build_scene


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_scene(load_protocol(), target="abdomen", skin=False).model


@pytest.mark.parametrize("part", [*sorted(GIVES), BELLY_FLOOR])
def test_a_plate_is_stable_in_the_fast_mode(part: str) -> None:
    """Semi-implicit Euler with implicit damping holds a spring while (w h)^2 < 4 + 2 h c / m."""
    give = FLOOR_GIVE if part == BELLY_FLOOR else GIVES[part]
    swing = np.sqrt(give.a_n_m / give.mass_kg) * FAST_DT_S
    assert swing**2 < 0.8 * (4 + 2 * FAST_DT_S * give.damping_ns_m / give.mass_kg)
    assert give.source


def test_the_chest_is_the_published_curve() -> None:
    """F = 54.9 D + 10.8 D^2 in newtons and centimetres."""
    depth_cm = np.array([0.5, 1.0, 3.0])
    np.testing.assert_allclose(GIVES["chest"].force_n(depth_cm / 100), 54.9 * depth_cm + 10.8 * depth_cm**2)


def test_what_is_left_of_a_bone_makes_up_the_segment_with_its_plates() -> None:
    row = SegmentInertia(mass_kg=9.0, centre_m=np.array([0.1, 0.0, 0.3]), axes=np.eye(3),
                         moments_kgm2=np.array([0.2, 0.25, 0.1]))  # fmt: skip
    places = [(plate, np.array([0.1 * k, -0.05, 0.2])) for k, plate in enumerate(plates_of("thorax"))]
    mass, centre, tensor = without_plates(row, places)
    bodies = [
        (mass, centre, tensor),
        *((p.give.mass_kg, at, p.give.mass_kg * SIZE_M**2 * np.eye(3)) for p, at in places),
    ]
    whole = sum(m for m, _, _ in bodies)
    middle = sum(m * at for m, at, _ in bodies) / whole
    assert whole == pytest.approx(row.mass_kg)
    np.testing.assert_allclose(middle, row.centre_m, atol=1e-12)
    total = sum(t + m * ((at - middle) @ (at - middle) * np.eye(3) - np.outer(at - middle, at - middle))
                for m, at, t in bodies)  # fmt: skip
    np.testing.assert_allclose(total, np.diag(row.moments_kgm2), atol=1e-12)


def test_plates_hang_on_their_segment_and_give_way_inward_by_the_declared_spring(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for plate in PLATES:
        body = model.body(plate_body(plate.name))
        assert model.body(body.parentid[0]).name == body_name(plate.segment)
        assert body.geomnum[0] >= 1
        joints = range(body.jntadr[0], body.jntadr[0] + body.jntnum[0])
        assert len(joints) == len(plate.outward)
        for joint, outward in zip(joints, plate.outward, strict=True):
            np.testing.assert_allclose(model.jnt_axis[joint], -outward, atol=1e-9)
            assert model.jnt_stiffness[joint] == plate.give.a_n_m
        # Its own weight moves a plate by less than a millimetre.
        assert 9.81 * plate.give.mass_kg / plate.give.a_n_m < 1e-3


def test_they_give_way_sideways_where_a_tool_comes_from_the_side(model: mujoco.MjModel) -> None:
    assert {plate.name for plate in PLATES if len(plate.outward) == 2} == {
        "left_flank", "left_thigh", *(f"right_{part}" for part in GIVES)
    }  # fmt: skip
    data = mujoco.MjData(model)
    thigh = model.body(plate_body("left_thigh"))
    data.qvel[model.jnt_dofadr[thigh.jntadr[0] + 1]] = 1.0
    mujoco.mj_forward(model, data)
    moves = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, thigh.id, moves, 0)
    # The person's left is the world's -y: the joint's positive way is that in which the robot pushes.
    assert moves[4] == pytest.approx(-1.0, abs=0.1)


def test_the_bone_under_the_belly_rests_on_a_plate(model: mujoco.MjModel) -> None:
    assert carriers(model, "human_core_abdomen") == {plate_body(BELLY_FLOOR)}


@pytest.mark.parametrize("part", ARM)
def test_all_bone_of_the_soft_arm_rests_on_a_plate(model: mujoco.MjModel, part: str) -> None:
    for kind in ("core", "hull"):
        of = part if kind == "core" else f"right_{part}"
        assert carriers(model, f"human_{kind}_{of}") == {plate_body(f"right_{part}")}


def carriers(model: mujoco.MjModel, geoms: str) -> set[str]:
    """Names of the bodies that carry the geoms whose names begin so."""
    found = [g for g in range(model.ngeom) if model.geom(g).name.startswith(geoms)]
    assert len(found) > 1
    return {model.body(model.geom_bodyid[g]).name for g in found}


def test_segments_with_their_plates_weigh_what_is_declared(model: mujoco.MjModel) -> None:
    for segment, row in segment_inertias(load_body(load_protocol().person.body)).items():
        parts = [body_name(segment), *(plate_body(p.name) for p in plates_of(segment))]
        assert sum(float(model.body(name).mass[0]) for name in parts) == pytest.approx(row.mass_kg, rel=1e-9)
