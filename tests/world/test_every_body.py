"""Every shipped body builds, settles and lies well."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from carecontact.protocols import load_protocol, overridden
from carecontact.sim.simulation import Simulation
from carecontact.world.human.anthropometry import segment_inertias
from carecontact.world.human.library import body_names
from carecontact.world.human.pose import BOARD_HEIGHT_M
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import Scene, build_scene
from tests.world.test_person_physics import skin_in_world

PROTOCOL = load_protocol()
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
