"""Against scipy, whose quaternions are xyzw."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from carecontact.errors import SceneError
from carecontact.interface.geometry import Triangles, matrix_from_quat, pose_matrix, quat_from_matrix

quats = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)


def scipy_rotation(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat[[1, 2, 3, 0]])


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(matrix_from_quat(np.array([half, 0, 0, half])) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@given(quats)
def test_matrix_is_scipys(quat: np.ndarray) -> None:
    np.testing.assert_allclose(matrix_from_quat(quat), scipy_rotation(quat).as_matrix(), atol=1e-12)


@given(quats)
def test_back_from_the_matrix_with_positive_w(quat: np.ndarray) -> None:
    back = quat_from_matrix(scipy_rotation(quat).as_matrix())
    assert back[0] >= 0
    assert np.linalg.norm(back) == pytest.approx(1)
    assert abs(back @ quat) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("axis", [*np.eye(3), np.array([0.6, 0.0, 0.8]), np.array([0.36, -0.48, 0.8])])
@pytest.mark.parametrize("off", [0.0, 1e-9, -1e-9])
def test_half_turns_are_stable(axis: np.ndarray, off: float) -> None:
    """Where the textbook formula divides by nearly zero."""
    matrix = Rotation.from_rotvec((np.pi + off) * axis).as_matrix()
    np.testing.assert_allclose(matrix_from_quat(quat_from_matrix(matrix)), matrix, atol=1e-9)


def test_batches_keep_their_shape() -> None:
    batch = np.random.default_rng(0).normal(size=(2, 3, 4))
    batch /= np.linalg.norm(batch, axis=-1, keepdims=True)
    matrices = matrix_from_quat(batch)
    assert matrices.shape == (2, 3, 3, 3)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(matrices[index], scipy_rotation(batch[index]).as_matrix(), atol=1e-12)


@given(quats)
def test_pose_turns_then_shifts(quat: np.ndarray) -> None:
    shift, point = np.array([0.1, -2.0, 3.0]), np.array([0.4, 0.5, -0.6])
    moved = pose_matrix(shift, quat) @ [*point, 1.0]
    np.testing.assert_allclose(moved, [*(scipy_rotation(quat).apply(point) + shift), 1.0], atol=1e-12)


# Rays onto triangles, on walls with known distances.


def test_rays_hit_the_nearer_of_two_walls() -> None:
    wall = np.array([[[0.0, -1, -1], [0, 1, -1], [0, 0, 2]]])
    walls = np.concatenate([wall + [2.0, 0, 0], wall + [3.0, 0, 0], wall - [1.0, 0, 0]])
    rng = np.random.default_rng(1)
    origins = np.stack([np.zeros(20), rng.uniform(-0.2, 0.2, 20), rng.uniform(-0.2, 0.2, 20)], 1)
    ahead = np.tile([1.0, 0, 0], (20, 1))
    np.testing.assert_allclose(Triangles(walls).first_hits(origins, ahead), 2.0)
    np.testing.assert_allclose(Triangles(walls).first_hits(origins[0], ahead[:1]), 2.0)
    slanted = np.array([[np.cos(0.05), np.sin(0.05), 0.0]])
    np.testing.assert_allclose(Triangles(walls).first_hits(np.zeros(3), slanted), 2.0 / np.cos(0.05))


def test_a_ray_that_misses_is_named_or_infinitely_long() -> None:
    wall = np.array([[[1.0, -1, -1], [1, 1, -1], [1, 0, 2]]])
    rays = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    assert Triangles(wall).distances(np.zeros(3), rays).tolist() == [pytest.approx(1.0), np.inf]
    assert Triangles(wall[:0]).distances(np.zeros(3), rays).tolist() == [np.inf, np.inf]
    with pytest.raises(SceneError, match=r"a ray from \[0.0, 0.0, 0.0\] misses"):
        Triangles(wall).first_hits(np.zeros(3), rays)
