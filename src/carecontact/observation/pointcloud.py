"""Back-projection of depth images."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]

WINDOWS_PX = (2, 6)
"""Half widths of the windows whose median depth stands for a landmark: one pixel is 3-4 mm overhead, edges are noisy;
the wider one serves a landmark that falls just beside its limb."""


def back_project(uv: npt.ArrayLike, depth: npt.ArrayLike, intrinsics: F64, pose_camera_in_base: F64) -> F64:
    """(..., 2) pixels and (...) depths along the optical axis [m] -> (..., 3) points in base [m]; NaN stays NaN."""
    uv = np.asarray(uv, np.float64)
    return _placed(uv[..., 0], uv[..., 1], np.asarray(depth, np.float64), intrinsics, pose_camera_in_base)


def _placed(u: F64, v: F64, depth: F64, intrinsics: F64, pose_camera_in_base: F64) -> F64:
    """``u`` and ``v`` broadcast against ``depth`` (...); returns (..., 3)."""
    points = np.empty((*depth.shape, 3))
    np.multiply((u - intrinsics[0, 2]) / intrinsics[0, 0], depth, out=points[..., 0])
    np.multiply((v - intrinsics[1, 2]) / intrinsics[1, 1], depth, out=points[..., 1])
    points[..., 2] = depth
    points = points @ pose_camera_in_base[:3, :3].T
    points += pose_camera_in_base[:3, 3]
    return points


def organised_points(depth: F32, intrinsics: F64, pose_camera_in_base: F64) -> F64:
    """(H, W) depth -> (H, W, 3) points in base [m]."""
    v, u = np.ogrid[: depth.shape[0], : depth.shape[1]]
    return _placed(u, v, depth.astype(np.float64), intrinsics, pose_camera_in_base)


def coloured_cloud(points: F64, rgb: U8) -> tuple[F32, U8]:
    """(H, W, 3) points and colours -> (N, 3), (N, 3): the pixels with a depth, row by row."""
    valid = np.isfinite(points).all(-1).ravel()
    # Six times as fast as an index of booleans.
    return np.compress(valid, points.reshape(-1, 3).astype(np.float32), 0), np.compress(valid, rgb.reshape(-1, 3), 0)


def surface_under(landmarks: F32, depth: F32, intrinsics: F64, pose_camera_in_base: F64, *, where: Bool | None) -> F32:
    """(33, 3) landmarks -> (33, 3) surface points in base [m], NaN outside the image or without a depth.

    ``where`` (H, W) limits the depths that count, e.g. to the person's pixels.
    """
    height, width = depth.shape
    usable = np.isfinite(depth) if where is None else np.isfinite(depth) & where
    surface = np.full((len(landmarks), 3), np.nan, np.float32)
    for index, (u, v, _) in enumerate(landmarks):
        if not (np.isfinite(u) and np.isfinite(v) and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        column, row = round(float(u)), round(float(v))
        for half in WINDOWS_PX:
            window = np.s_[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
            depths = depth[window][usable[window]]
            if depths.size:
                surface[index] = back_project([u, v], float(np.median(depths)), intrinsics, pose_camera_in_base)
                break
    return surface
