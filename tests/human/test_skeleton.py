"""The compiled person against the body it is built from: inertia and open places."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import mujoco
import numpy as np
import pytest

from carecontact.human.body import segment_inertias
from carecontact.human.hulls import plate_body, plates_of
from carecontact.human.library import body_names
from carecontact.human.pose import BOARD_HEIGHT_M, lying_pose_deg
from carecontact.human.skeleton import body_name
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.sim.simulation import Simulation
from carecontact.tissue.plugin import Readings
from carecontact.world.scene import Scene, build_scene

RADIUS, OPEN_M = 0.012, 0.040


@pytest.mark.parametrize("region", sorted(STANDARD_REGIONS))
def test_bone_and_shell_together_have_the_segments_inertia(scene_of: Callable[..., Scene], region: str) -> None:
    """Mass, centre of mass and inertia tensor of de Leva's segment; the bone's counts its shell, and its plates go with
    it."""
    model, body = scene_of(region).model, scene_of(region).body
    segment = REGIONS[region].segment
    parts = [model.body(name).id for name in (body_name(segment), *(plate_body(p.name) for p in plates_of(segment)))]
    row, origin = segment_inertias(body)[segment], body.joint_centre[segment]
    mass = model.body_mass[parts]
    centre = mass @ model.body_ipos[parts] / mass.sum()
    tensor, turn = np.zeros((3, 3)), np.zeros(9)
    for part in parts:
        mujoco.mju_quat2Mat(turn, model.body_iquat[part])
        off = model.body_ipos[part] - centre
        tensor += turn.reshape(3, 3) @ np.diag(model.body_inertia[part]) @ turn.reshape(3, 3).T
        tensor += model.body_mass[part] * (off @ off * np.eye(3) - np.outer(off, off))
    assert mass.sum() == pytest.approx(row.mass_kg, rel=1e-6)
    np.testing.assert_allclose(origin + centre, row.centre_m, atol=1e-5)
    wanted = row.axes @ np.diag(row.moments_kgm2) @ row.axes.T
    np.testing.assert_allclose(tensor, wanted, atol=0.01 * row.moments_kgm2.max())


def test_nothing_of_the_person_is_open_to_the_tool(scene_of: Callable[..., Scene]) -> None:
    """A tool-sized ball let down on a 30 mm grid meets something at most 40 mm under the skin (neck, armpit)."""
    scene = scene_of("forearm")
    model = scene.model
    data = mujoco.MjData(model)
    pose = lying_pose_deg(scene.body, 52.5)
    for hinge in scene.hinges:
        angle = pose.get(hinge.name, hinge.bind_deg)
        data.qpos[model.joint(f"human_{hinge.name}").qposadr[0]] = np.radians(angle)
    mujoco.mj_forward(model, data)
    skin = skin_in_world(model, data)
    touchable = [
        g
        for g in range(model.ngeom)
        if model.geom_conaffinity[g] & 1 and model.body(model.geom_bodyid[g]).name.startswith("human_")
    ]
    felt = [Readings(model, name) for name in scene.regions]
    shells = np.concatenate([data.xpos[f.bone] + f.places @ data.xmat[f.bone].reshape(3, 3).T for f in felt])
    open_places, probed = [], 0
    for x in np.arange(-0.95, 0.80, 0.03):
        for y in np.arange(-0.35, 0.75, 0.03):
            # Off the outline, where a ball slides down the side of the body anyway.
            around = [(x + dx, y + dy) for dx, dy in ((0, 0), (0.02, 0), (-0.02, 0), (0, 0.02), (0, -0.02))]
            if any(np.hypot(skin[:, 0] - a, skin[:, 1] - b).min() > 0.012 for a, b in around):
                continue
            top = skin[np.hypot(skin[:, 0] - x, skin[:, 1] - y) < 0.012, 2].max()
            probed += 1
            over_shell = shells[np.hypot(shells[:, 0] - x, shells[:, 1] - y) < 0.030]
            reach = over_shell[:, 2].max(initial=-1.0)
            for g in touchable:
                # The ball meets what lies under any part of it.
                for dx, dy in ((0, 0), (RADIUS, 0), (-RADIUS, 0), (0, RADIUS), (0, -RADIUS)):
                    reach = max(reach, ray_down(model, data, g, np.array([x + dx, y + dy, 1.5])))
            if top - reach > OPEN_M:
                open_places.append((round(x, 2), round(y, 2), round(float(top - reach), 3)))
    assert probed > 300
    assert open_places == []


def ray_down(model: mujoco.MjModel, data: mujoco.MjData, geom: int, start: np.ndarray) -> float:
    """Height at which a vertical ray meets one geom, -1 if it does not."""
    direction = np.array([0.0, 0.0, -1.0])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        distance = mujoco.mj_rayMesh(model, data, geom, start, direction, None)
    else:
        distance = mujoco.mju_rayGeom(
            data.geom_xpos[geom],
            data.geom_xmat[geom],
            model.geom_size[geom],
            start,
            direction,
            model.geom_type[geom],
            None,
        )
    return start[2] - distance if distance >= 0 else -1.0


def skin_in_world(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    scene = mujoco.MjvScene(model, maxgeom=2000)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera(), int(mujoco.mjtCatBit.mjCAT_ALL), scene
    )
    return np.asarray(scene.skinvert).reshape(-1, 3)[: model.nskinvert].astype(np.float64)


PROTOCOL = load_protocol("bathing-v3")
QUICK = ("woman-old-light", "man-adult-heavy")
EVERY = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in body_names()]


@cache
def scene_with(name: str) -> Scene:
    return build_scene(overridden(PROTOCOL, {"person.body": name}), target="upper_arm", skin=name in QUICK)


@pytest.mark.parametrize("name", EVERY)
def test_masses_add_up(name: str) -> None:
    scene = scene_with(name)
    model, body = scene.model, scene.body
    assert sum(row.mass_kg for row in segment_inertias(body).values()) == pytest.approx(body.mass_kg, rel=1e-9)
    assert model.body_subtreemass[model.body("human_pelvis").id] == pytest.approx(body.mass_kg, rel=1e-5)


@pytest.mark.parametrize("name", EVERY)
def test_settles_at_the_asked_angle_with_every_joint_inside_its_range(name: str) -> None:
    simulation = Simulation(scene_with(name))
    for angle in (45.0, 52.5, 60.0):
        settled = simulation.settle(angle)
        assert settled.comfort_arm_deg == pytest.approx(angle, abs=1.0)
        assert simulation.human_speed() < PROTOCOL.phases.settle_speed_m_s
        q, (low, high) = settled.joint_position, simulation.joint_range.T
        margin = np.degrees(np.minimum(q - low, high - q))
        assert margin.min() >= 5, simulation.joint_names[margin.argmin()]


@pytest.mark.slow
@pytest.mark.parametrize("name", body_names())
def test_drifts_less_than_a_degree_in_ten_seconds(name: str) -> None:
    simulation = Simulation(scene_with(name))
    before = simulation.settle(52.5).joint_position
    simulation.start()
    simulation.advance(round(10 / PROTOCOL.physics.dt_s))
    joints = [simulation.model.joint(f"human_{n}").qposadr[0] for n in simulation.joint_names]
    assert np.degrees(np.abs(simulation.data.qpos[joints] - before)).max() < 1


@pytest.mark.parametrize("name", QUICK)
def test_skin_lies_on_what_is_under_it(name: str) -> None:
    """Neither through the board and the mattress nor afloat; only the buttocks sink in, as they do in a mattress."""
    scene = scene_with(name)
    simulation = Simulation(scene)
    simulation.settle(52.5)
    model, data = scene.model, simulation.data
    skin, top = skin_in_world(model, data), PROTOCOL.scene.mattress_top_m
    low, high = np.array(PROTOCOL.scene.board_low_m), np.array(PROTOCOL.scene.board_high_m)
    over_board = ((skin[:, :2] > low) & (skin[:, :2] < high)).all(1)
    clearance = skin[:, 2] - top - np.where(over_board, BOARD_HEIGHT_M, 0.0)
    assert -0.010 < clearance[over_board].min() < 0.003
    owner = np.argmax([weights_of(scene, k) for k in range(len(scene.body.segments))], axis=0)
    for segment in ("left_forearm", "left_hand", "left_foot", "right_foot", "thorax"):
        lowest = clearance[(owner == scene.body.segments.index(segment)) & ~over_board].min()
        assert -0.020 < lowest < 0.010, segment
    pelvis = clearance[owner == scene.body.segments.index("pelvis")].min()
    assert -0.045 < pelvis < 0.010
    head = clearance[owner == scene.body.segments.index("head")].min()
    assert 0.030 < head < 0.060, "on the pillow"


def weights_of(scene: Scene, segment: int) -> np.ndarray:
    """(n,) weight of every skin vertex on one segment's bone."""
    model = scene.model
    bone = model.skin_bonebodyid.tolist().index(model.body(body_name(scene.body.segments[segment])).id)
    rows = slice(model.skin_bonevertadr[bone], model.skin_bonevertadr[bone] + model.skin_bonevertnum[bone])
    out = np.zeros(model.nskinvert)
    out[model.skin_bonevertid[rows]] = model.skin_bonevertweight[rows]
    return out
