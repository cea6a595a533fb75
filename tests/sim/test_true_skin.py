from __future__ import annotations

import mujoco
import numpy as np

from carecontact.sim.true_skin import skin_in_world, top_of_skin

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
    spec.add_skin(
        name="human", vert=SQUARE.ravel(), face=FACES.ravel(), bodyname=["one", "two"], bindpos=[0, 0, 0, 1, 0, 0],
        bindquat=[1, 0, 0, 0] * 2, vertid=[np.array([0, 2]), np.array([1, 2, 3])],
        vertweight=[np.array([1.0, 0.5]), np.array([1.0, 0.5, 1.0])],
    )  # fmt: skip
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[7:10] = [0, 0, 1], [1, 0, 0]
    half = np.sqrt(0.5)
    data.qpos[10:14] = [half, 0, 0, half]  # the second bone turns by 90 degrees about z
    mujoco.mj_kinematics(model, data)
    expected = [[0, 0, 1], [1, 0, 0], [0, 0, 1.0], [0, 0, 0.5]]
    np.testing.assert_allclose(skin_in_world(model, data), expected, atol=1e-6)
