from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carecontact.observation.pointcloud import back_project, coloured_cloud, organised_points, surface_under

INTRINSICS = np.array([[100.0, 0, 31.5], [0, 100.0, 23.5], [0, 0, 1]])
# 2 m over the base's origin, looking straight down: image right is base -y, image down is base -x.
DOWN = np.array([[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]], float)


def test_known_pixels() -> None:
    points = back_project([[31.5, 23.5], [41.5, 23.5], [31.5, 3.5]], [2.0, 1.5, 2.0], INTRINSICS, DOWN)
    np.testing.assert_allclose(points, [[0, 0, 0], [0, -0.15, 0.5], [0.4, 0, 0]], atol=1e-12)


@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3), z=st.floats(0.0, 1.0))
def test_projection_is_undone(x: float, y: float, z: float) -> None:
    in_camera = DOWN[:3, :3].T @ (np.array([x, y, z]) - DOWN[:3, 3])
    uv = (INTRINSICS @ in_camera)[:2] / in_camera[2]
    np.testing.assert_allclose(back_project(uv, in_camera[2], INTRINSICS, DOWN), [x, y, z], atol=1e-9)


def test_the_cloud_leaves_out_pixels_without_depth() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[0, :10] = np.nan
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[0, 10] = 7
    points, colors = coloured_cloud(organised_points(depth, INTRINSICS, DOWN), rgb)
    assert points.shape == colors.shape == (48 * 64 - 10, 3)
    assert (colors[0] == 7).all()
    np.testing.assert_allclose(points[:, 2], 0, atol=1e-6)


def test_surface_under_landmarks() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[20:28, 28:36] = 1.5
    limb = depth < 1.9
    landmarks = np.array([[31.5, 23.5, 1], [38.0, 23.5, 1], [5, 5, 1], [80, 5, 1], [np.nan] * 3], np.float32)
    surface = surface_under(landmarks, depth, INTRINSICS, DOWN, where=limb)
    np.testing.assert_allclose(surface[0], [0, 0, 0.5], atol=1e-6)
    # Two pixels beside the limb the wider window still finds it; far away nothing does.
    np.testing.assert_allclose(surface[1], [0, -6.5 * 1.5 / 100, 0.5], atol=1e-6)
    assert np.isnan(surface[2:]).all()
    anywhere = surface_under(landmarks, depth, INTRINSICS, DOWN, where=None)
    assert np.isfinite(anywhere[2]).all()
    assert np.isnan(anywhere[3:]).all()
