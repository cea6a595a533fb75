"""The drawn skin follows the shell, stays out of the tool and has no seam."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.contract.embodiment import PANDA
from carecontact.recording import Recording
from carecontact.replaying.film.grid import LINE_M, SkinGrid
from carecontact.replaying.film.skin import FilmSkin, film_scene
from carecontact.replaying.replay import STATE, Replay
from carecontact.sim.true_skin import skin_in_world
from carecontact.world.scene import Scene

World = tuple[Scene, FilmSkin, mujoco.MjData]


@pytest.fixture(scope="module")
def world(pressed: Recording) -> World:
    """At the last shown state, pressed."""
    replay = Replay(pressed)
    scene = film_scene(replay.scene, "forearm")
    data = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, data, list(replay.stretches(10.0))[-1].states[-1], STATE)
    mujoco.mj_kinematics(scene.model, data)
    return scene, FilmSkin(scene), data


def test_the_skin_gives_way_under_the_tool_and_nowhere_else(world: World, pressed: Recording) -> None:
    scene, skin, data = world
    rest = skin_in_world(scene.model, data)
    vertices, _ = skin.placed(data)
    moved = np.linalg.norm(vertices - rest, axis=1)
    depth = float(pressed["scorer/indentation_m"][-1].max())
    assert depth > 0.004
    assert 0.7 * depth < moved.max() < 1.6 * depth
    far = np.linalg.norm(rest - data.site(PANDA.tcp_site).xpos, axis=1) > 0.08
    assert moved[far].max() < 5e-4
    assert not moved[~skin.dentable].any()


def test_no_skin_is_inside_the_tool(world: World) -> None:
    _, skin, data = world
    vertices, _ = skin.placed(data)
    tip = data.geom(PANDA.tip.geom)
    local = (vertices - tip.xpos) @ tip.xmat.reshape(3, 3) / np.array(PANDA.tip.half_m)
    assert np.linalg.norm(local, axis=1).min() > 1


def test_vertices_at_one_place_have_one_normal(world: World) -> None:
    scene, skin, data = world
    _, normals = skin.placed(data)
    bind = np.asarray(scene.model.skin_vert).reshape(-1, 3)
    order = np.lexsort(bind.T)
    same = (bind[order][1:] == bind[order][:-1]).all(1)
    assert same.any(), "seams of the texture split vertices"
    assert np.allclose(normals[order][1:][same], normals[order][:-1][same])
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)


def test_lines_are_where_the_region_has_whole_steps(world: World) -> None:
    scene, _, _ = world
    grid, frame = SkinGrid(scene, "forearm"), scene.frames["forearm"]
    bind = np.asarray(scene.model.skin_vert, np.float64).reshape(-1, 3)
    ends = bind[grid._pairs]
    points = ends[..., 0, :] + grid._shares[..., None] * (ends[..., 1, :] - ends[..., 0, :])
    local = ((points.reshape(-1, 3) - frame.origin) @ frame.axes)[:, :2] / LINE_M
    assert len(local) > 1000
    assert np.abs(local - np.round(local)).min(1).max() < 1e-6
