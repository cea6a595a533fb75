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
    uv, depth = np.asarray(uv, np.float64), np.asarray(depth, np.float64)
    x = (uv[..., 0] - intrinsics[0, 2]) / intrinsics[0, 0] * depth
    y = (uv[..., 1] - intrinsics[1, 2]) / intrinsics[1, 1] * depth
    in_camera = np.stack([x, y, depth], -1)
    return in_camera @ pose_camera_in_base[:3, :3].T + pose_camera_in_base[:3, 3]


def organised_points(depth: F32, intrinsics: F64, pose_camera_in_base: F64) -> F64:
    """(H, W) depth -> (H, W, 3) points in base [m]."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    return back_project(np.stack([u, v], -1), depth, intrinsics, pose_camera_in_base)


def coloured_cloud(points: F64, rgb: U8) -> tuple[F32, U8]:
    """(H, W, 3) points and colours -> (N, 3), (N, 3): the pixels with a depth, row by row."""
    valid = np.isfinite(points).all(-1)
    return points[valid].astype(np.float32), rgb[valid]


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
