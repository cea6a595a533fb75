"""Rotations and projections at the interface between policy and benchmark; quaternions are wxyz."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def matrix_from_quat(quat_wxyz: Array) -> Array:
    """(..., 4) unit quaternion -> (..., 3, 3)."""
    quat = np.asarray(quat_wxyz, np.float64)
    # Plain numbers are ten times as fast as arrays of one, and give the same bits.
    alone = quat.ndim == 1
    w, x, y, z = quat.tolist() if alone else np.moveaxis(quat, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows) if alone else np.stack([np.stack(row, -1) for row in rows], -2)


def quat_from_matrix(matrix: Array) -> Array:
    """(3, 3) -> (4,) with w >= 0; the eigenvector method of Bar-Itzhack (2000), stable at every angle."""
    m = np.asarray(matrix, np.float64)
    k = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    q = np.linalg.eigh(k)[1][:, -1]
    return q if q[0] >= 0 else -q


def pixels(points_m: Array, intrinsics: Array, pose_camera: Array) -> Array:
    """(..., 3) points, (3, 3) pinhole matrix, (4, 4) camera pose in the points' frame -> (..., 2) u, v [px]."""
    in_camera = (points_m - pose_camera[:3, 3]) @ pose_camera[:3, :3]
    projected = in_camera @ intrinsics.T
    return projected[..., :2] / projected[..., 2:]


def pose_matrix(position: Array, quat_wxyz: Array) -> Array:
    """(3,), (4,) -> (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = matrix_from_quat(quat_wxyz)
    out[:3, 3] = position
    return out
