"""Rotations, quaternions (wxyz), projections and rays, with numpy alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError

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


def matrix_from_vector(vector: Array) -> Array:
    """(3,) rotation vector [rad], axis times angle -> (3, 3)."""
    v = np.asarray(vector, np.float64)
    half = float(np.linalg.norm(v)) / 2
    # np.sinc(x) is sin(pi x) / (pi x).
    return matrix_from_quat(np.array([np.cos(half), *(0.5 * np.sinc(half / np.pi) * v)]))


def vector_from_matrix(matrix: Array) -> Array:
    """(3, 3) -> (3,) rotation vector [rad] of at most half a turn."""
    w, *rest = quat_from_matrix(matrix)
    sine = float(np.linalg.norm(rest))
    return np.array(rest) * (2.0 * np.arctan2(sine, w) / sine if sine > 0 else 2.0)


def matrix_from_euler_xyz(angles: Array) -> Array:
    """(3,) angles [rad] about the fixed axes x, y and z, applied in this order -> (3, 3)."""
    x, y, z = (matrix_from_vector(angle * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    return z @ y @ x


def euler_xyz_from_matrix(matrix: Array) -> Array:
    """(3, 3) -> (3,) angles [rad] about the fixed axes x, y and z, applied in this order; y within a quarter turn."""
    m = np.asarray(matrix, np.float64)
    y = np.arctan2(-m[2, 0], np.hypot(m[0, 0], m[1, 0]))
    return np.array([np.arctan2(m[2, 1], m[2, 2]), y, np.arctan2(m[1, 0], m[0, 0])])


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


class Triangles:
    """Triangles with corners (m, 3, 3), prepared for many rays (Moeller and Trumbore 1997, J Graphics Tools 2:21)."""

    def __init__(self, corners: Array) -> None:
        a = corners[:, 0]
        self._e1, self._e2 = corners[:, 1] - a, corners[:, 2] - a
        self._normal = np.cross(self._e1, self._e2)
        self._e1_a, self._e2_a = np.cross(self._e1, a), np.cross(self._e2, a)
        self._offset = np.einsum("ij,ij->i", a, self._normal)

    def first_hits(self, origins: Array, directions: Array) -> Array:
        """Return the distance (n,) to the first hit along each ray, as ``distances`` does.

        Raises SceneError when a ray misses.
        """
        first = self.distances(origins, directions)
        if np.isinf(first).any():
            begins: Array = np.broadcast_to(origins, directions.shape)[np.isinf(first)][0]
            place = np.round(begins, 3).tolist()
            raise SceneError(f"a ray from {place} misses the body's surface: the region does not fit this body")
        return first

    def distances(self, origins: Array, directions: Array) -> Array:
        """Return the distance (n,) to the first hit along each ray; infinite for a ray that misses.

        Args:
            origins, directions: (n, 3); a single origin is used for all rays. Distances are multiples of the length of
                the direction.
        """
        o = np.broadcast_to(origins, directions.shape)
        # The triple products of the method, for all rays and triangles at once, as matrix products.
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = -1 / (directions @ self._normal.T)
            turned = np.cross(o, directions)
            u = (turned @ self._e2.T - directions @ self._e2_a.T) * inverse
            v = (directions @ self._e1_a.T - turned @ self._e1.T) * inverse
            distance = (o @ self._normal.T - self._offset) * inverse
            hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
        return np.where(hit, distance, np.inf).min(1, initial=np.inf)


def back_project(uv: npt.ArrayLike, depth: npt.ArrayLike, intrinsics: Array, pose_camera_in_base: Array) -> Array:
    """(..., 2) pixels and (...) depths along the optical axis [m] -> (..., 3) points in base [m]; NaN stays NaN."""
    uv = np.asarray(uv, np.float64)
    return back_projected(uv[..., 0], uv[..., 1], np.asarray(depth, np.float64), intrinsics, pose_camera_in_base)


def back_projected(u: Array, v: Array, depth: Array, intrinsics: Array, pose_camera_in_base: Array) -> Array:
    """``u`` and ``v`` broadcast against ``depth`` (...); returns (..., 3)."""
    points = np.empty((*depth.shape, 3))
    np.multiply((u - intrinsics[0, 2]) / intrinsics[0, 0], depth, out=points[..., 0])
    np.multiply((v - intrinsics[1, 2]) / intrinsics[1, 1], depth, out=points[..., 1])
    points[..., 2] = depth
    points = points @ pose_camera_in_base[:3, :3].T
    points += pose_camera_in_base[:3, 3]
    return points
