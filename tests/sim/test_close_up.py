"""The drawn dent: no OpenGL is needed to prepare a scene."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree

from carecontact.human.skeleton import body_name
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.sim.close_up import dent, nearest, skin_shift
from carecontact.sim.state import skin_in_world, top_of_skin
from carecontact.tissue.plugin import Readings
from carecontact.world.scene import Scene

DEPTH_M = 0.006
RADIUS_M = 0.025
NEAR_M = 0.016
"""Skin lies on the shell: what is farther from it than this is no skin of the region."""


@pytest.fixture(scope="module")
def scene(scene_of: Callable[[str | None], Scene]) -> Scene:
    return scene_of("forearm")


@pytest.fixture
def data(scene: Scene) -> mujoco.MjData:
    """Turned at shoulder and elbow, so that bind pose and world are not confused."""
    data = mujoco.MjData(scene.model)
    for name, angle in (("right_upper_arm_abduction", 52.5), ("right_forearm_flexion", 40.0)):
        data.qpos[scene.model.joint(f"human_{name}").qposadr[0]] = np.radians(angle)
    mujoco.mj_forward(scene.model, data)
    return data


@pytest.fixture(scope="module")
def drawn(scene: Scene) -> Callable[[mujoco.MjData], mujoco.MjvScene]:
    def prepared(data: mujoco.MjData) -> mujoco.MjvScene:
        made = mujoco.MjvScene(scene.model, maxgeom=4 * scene.model.ngeom)
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(scene.model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), every, made)
        return made

    return prepared


def arrays(made: mujoco.MjvScene) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.asarray(made.skinvert).reshape(-1, 3).astype(float),
        np.asarray(made.skinnormal).reshape(-1, 3).astype(float),
    )


def dented(scene: Scene, made: mujoco.MjvScene, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Vertices before and after the dent is drawn into a prepared scene."""
    before, _ = arrays(made)
    dent(scene, made, skin_shift(scene, data))
    return before, arrays(made)[0]


def press(scene: Scene, data: mujoco.MjData, region: str, depth_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Push the shell's middle in; returns world place and outward normal of the pressed point."""
    shell, felt = scene.regions[region].shell, Readings(scene.model, region)
    top = shell.frame_origin + shell.frame[:, 2] * shell.axis_depth_m
    middle = np.linalg.norm(shell.vertices - top, axis=1).argmin()
    pressed = np.linalg.norm(shell.vertices - shell.vertices[middle], axis=1) < RADIUS_M
    felt.displacement(data)[pressed, 0] = depth_m
    mujoco.mj_kinematics(scene.model, data)
    bone = data.body(body_name(REGIONS[region].segment))
    turn = bone.xmat.reshape(3, 3)
    place = bone.xpos + turn @ (shell.vertices[middle] - scene.body.joint_centre[REGIONS[region].segment])
    return place, turn @ shell.normals[middle]


def test_an_undented_person_is_drawn_as_before(scene: Scene, data: mujoco.MjData, drawn: Callable) -> None:
    made = drawn(data)
    vertices, normals = arrays(made)
    dent(scene, made, skin_shift(scene, data))
    after_vertices, after_normals = arrays(made)
    np.testing.assert_array_equal(after_vertices, vertices)
    np.testing.assert_array_equal(after_normals, normals)


@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_a_dent_moves_only_skin_near_the_pressed_shell_and_inward(
    scene: Scene, data: mujoco.MjData, drawn: Callable, region: str
) -> None:
    place, outward = press(scene, data, region, DEPTH_M)
    made = drawn(data)
    before, after = dented(scene, made, data)
    _, normals = arrays(made)
    change = after - before
    moved = np.linalg.norm(change, axis=1) > 1e-5
    assert moved.any()
    # A vertex follows its four nearest shell vertices, so the rim may lie a mesh width or two beyond the press.
    spacing = scene.regions[region].tissue.spacing_m
    assert np.linalg.norm(before[moved] - place, axis=1).max() < RADIUS_M + NEAR_M + 2 * spacing
    free = scene.regions[region].shell.vertices
    bind = np.asarray(scene.model.skin_vert).reshape(-1, 3)[moved]
    assert cKDTree(free).query(bind)[0].max() < NEAR_M
    assert (change[moved] @ outward < 0).mean() > 0.95
    assert np.linalg.norm(change, axis=1).max() <= DEPTH_M * 1.001
    deepest = np.linalg.norm(change, axis=1).max()
    # On a coarse shell a skin vertex seldom lies right over a shell vertex.
    assert deepest > (0.8 if spacing < RADIUS_M / 2 else 0.5) * DEPTH_M
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)


def test_skin_over_the_press_follows_the_shell(scene: Scene, data: mujoco.MjData, drawn: Callable) -> None:
    place, outward = press(scene, data, "forearm", DEPTH_M)
    before, after = dented(scene, drawn(data), data)
    change = after - before
    under = np.linalg.norm(before - place, axis=1) < 0.008
    assert under.sum() >= 3
    np.testing.assert_allclose(change[under] @ outward, -DEPTH_M, atol=0.25 * DEPTH_M)


def test_a_deeper_press_draws_a_deeper_dent(scene: Scene, drawn: Callable) -> None:
    deepest = []
    for depth_m in (0.002, 0.004, 0.008):
        data = mujoco.MjData(scene.model)
        press(scene, data, "forearm", depth_m)
        before, after = dented(scene, drawn(data), data)
        deepest.append(np.linalg.norm(after - before, axis=1).max())
    assert deepest == sorted(deepest)
    np.testing.assert_allclose(np.array(deepest) / deepest[0], [1, 2, 4], rtol=0.02)


def test_shading_tilts_at_the_rim_of_the_dent(scene: Scene, data: mujoco.MjData, drawn: Callable) -> None:
    place, _ = press(scene, data, "forearm", DEPTH_M)
    made = drawn(data)
    before, normals = arrays(made)
    dent(scene, made, skin_shift(scene, data))
    turned = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", arrays(made)[1], normals), -1, 1)))
    rim = np.abs(np.linalg.norm(before - place, axis=1) - RADIUS_M) < 0.008
    far = np.linalg.norm(before - place, axis=1) > 0.25
    assert turned[rim].max() > 10
    assert turned[far].max() < 0.1


@pytest.mark.parametrize("count", [1, 3, 4, 40])
def test_the_nearest_points_are_those_of_a_tree(count: int) -> None:
    generator = np.random.default_rng(0)
    places, points = generator.random((20, 3)), generator.random((count, 3))
    order, distance = nearest(places, points)
    wanted, found = cKDTree(points).query(places, k=list(range(1, min(4, count) + 1)))
    assert (order == found).all()
    assert distance == pytest.approx(wanted)


FACES = np.array([[0, 1, 2], [1, 3, 2]])
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.5], [1, 1, 0.5]])


def test_height_on_a_slope() -> None:
    assert top_of_skin(SQUARE, FACES, [0.5, 0.2]) == 0.1
    np.testing.assert_allclose(top_of_skin(SQUARE, FACES, [0.9, 0.8]), 0.4)
    assert np.isnan(top_of_skin(SQUARE, FACES, [1.1, 0.5]))


def test_the_upper_of_two_layers_counts() -> None:
    both, faces = np.concatenate([SQUARE, SQUARE + [0, 0, 1]]), np.concatenate([FACES + 4, FACES])
    np.testing.assert_allclose(top_of_skin(both, faces, [0.5, 0.2]), 1.1)


def test_skin_moves_with_its_bones() -> None:
    spec = mujoco.MjSpec()
    for name in ("one", "two"):
        bone = spec.worldbody.add_body(name=name)
        bone.add_geom(size=[0.1] * 3)
        bone.add_freejoint()
    bind = {"bodyname": ["one", "two"], "bindpos": [0, 0, 0, 1, 0, 0], "bindquat": [1, 0, 0, 0] * 2}
    ids, weights = [[0, 2], [1, 2, 3]], [[1.0, 0.5], [1.0, 0.5, 1.0]]
    follow = {"vertid": [np.array(row) for row in ids], "vertweight": [np.array(row) for row in weights]}
    spec.add_skin(name="human", vert=SQUARE.ravel(), face=FACES.ravel(), **bind, **follow)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[7:10] = [0, 0, 1], [1, 0, 0]
    half = np.sqrt(0.5)
    data.qpos[10:14] = [half, 0, 0, half]  # the second bone turns by 90 degrees about z
    mujoco.mj_kinematics(model, data)
    expected = [[0, 0, 1], [1, 0, 0], [0, 0, 1.0], [0, 0, 0.5]]
    np.testing.assert_allclose(skin_in_world(model, data), expected, atol=1e-6)
