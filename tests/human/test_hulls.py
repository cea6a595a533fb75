"""Plates: the segment keeps its mass, each plate swings as slowly as the fast mode can follow, and the
person has the plates that are declared."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull, cKDTree

from carecontact.human.body import Body, SegmentInertia, segment_inertias
from carecontact.human.hulls import (
    ARM,
    BELLY_FLOOR,
    FLOOR_GIVE,
    GIVES,
    PLATES,
    SIZE_M,
    Plane,
    below,
    clipped,
    girdle,
    parted,
    plate_body,
    plates_of,
    without_plates,
)
from carecontact.human.library import load_body
from carecontact.human.shell import belly_half_width, belly_span
from carecontact.human.skeleton import body_name
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import FAST_DT_S
from carecontact.world.scene import build_scene


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_scene(load_protocol("bathing-v3"), target="abdomen", skin=False).model


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
    centre, moments = np.array([0.1, 0.0, 0.3]), np.array([0.2, 0.25, 0.1])
    row = SegmentInertia(mass_kg=9.0, centre_m=centre, axes=np.eye(3), moments_kgm2=moments)
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
    offsets = [(m, at - middle, t) for m, at, t in bodies]
    total = sum(t + m * (off @ off * np.eye(3) - np.outer(off, off)) for m, off, t in offsets)
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
    sideways = {"left_flank", "left_thigh", *(f"right_{part}" for part in GIVES)}
    assert {plate.name for plate in PLATES if len(plate.outward) == 2} == sideways
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
    for segment, row in segment_inertias(load_body(load_protocol("bathing-v3").person.body)).items():
        parts = [body_name(segment), *(plate_body(p.name) for p in plates_of(segment))]
        assert sum(float(model.body(name).mass[0]) for name in parts) == pytest.approx(row.mass_kg, rel=1e-9)


APART_M = 1e-6


def inside(points: np.ndarray, hull: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) lie inside the convex hull of others, by more than APART_M."""
    planes = ConvexHull(hull).equations
    return (points @ planes[:, :3].T + planes[:, 3] < -APART_M).all(1)


def test_edges_are_cut_where_they_cross_a_plane(body: Body) -> None:
    low, _ = belly_span(body)
    points = clipped(body, ("right_thigh",), below(low - 0.13))
    assert points[:, 2].max() == pytest.approx(low - 0.13, abs=1e-9)
    assert (np.abs(points[:, 2] - (low - 0.13)) < 1e-9).sum() > 5
    above = clipped(body, ("right_thigh",), below(low - 0.13).turned)
    assert len(points) + len(above) > len(body.vertices_of("right_thigh"))


def test_no_hull_reaches_into_another_one(body: Body) -> None:
    found = parted(body)
    for side in ("left", "right"):
        names = [f"{side}_{part}" for part in ("chest", "shoulder", "flank", "hip", "thigh")]
        for name in names:
            for other in (n for n in names if n != name):
                assert not inside(found[name], found[other]).any(), (name, other)
    assert not inside(found["left_chest"], found["right_chest"]).any()
    assert not inside(found["left_hip"], found["right_hip"]).any()


def test_no_vertex_of_the_trunks_front_is_left_without_a_plate(body: Body) -> None:
    """Apart from the abdomen's, which its shell covers."""
    low, high = belly_span(body)
    found = cKDTree(np.concatenate(list(parted(body).values())))
    trunk = body.vertices_of("thorax", "abdomen", "pelvis")
    x, _, z = trunk.T
    bellied = (low < z) & (z < high) & (np.abs(x) < belly_half_width(body) - 0.01)
    plated = trunk[(z > low - 0.13) & ~bellied]
    assert len(plated) > 100
    assert found.query(plated)[0].max() < 1e-9


def test_the_plane_between_chest_and_shoulder_leaves_the_joint_to_the_shoulder(body: Body) -> None:
    for side in ("left", "right"):
        plane: Plane = girdle(body, side)
        joint = body.joint_centre[f"{side}_upper_arm"]
        assert np.linalg.norm(plane.normal) == pytest.approx(1.0)
        heights = plane.height_m(np.stack([joint, joint * [0.3, 1, 1], joint - [0, 0, 0.12]]))
        assert heights[0] > 0.015
        assert (heights[1:] < 0).all()
