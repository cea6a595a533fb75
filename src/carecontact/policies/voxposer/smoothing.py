"""Makes waypoints of a walk over voxels: smoothed, cut before a sharp bend, thinned out, and ended in a target voxel.

The steps are those of the release's planners.py, to which fixed_values.py gives the lines.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.maps import goals

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

# The package ships no types.
signal: Any = import_module("scipy.signal")


def waypoints(path: I64, target: F32) -> F64:
    """Return (n, 3) waypoints in voxels, with fractions, of a walk (m, 3); the last one is a voxel of the target.

    Args:
        path: (m, 3) voxels of the walk, at least two; the first is the tool's own and is left out.
        target: (MAP_SIZE,) * 3 affordance; voxels with the value 1 are the target.
    """
    window = min(fixed.SMOOTHING_WINDOW, len(path))
    order = min(fixed.SMOOTHING_ORDER, window - 1)
    smooth = np.asarray(signal.savgol_filter(path.astype(np.float64), window, order, axis=0), np.float64)
    smooth = smooth[: _length_before_bend(smooth)]
    points = np.vstack([_spaced(smooth[1:-1]), smooth[-1:]])
    end = np.clip(np.rint(points[-1]), 0, fixed.MAP_SIZE - 1).astype(np.int64)
    if target[tuple(end)] < 1:
        ends = goals(target)
        points = np.vstack([points, ends[int(np.linalg.norm(ends - end, axis=1).argmin())]])
    return np.clip(points, 0, fixed.MAP_SIZE - 1)


def _spaced(points: F64) -> F64:
    """Keep every n-th point, so that points are WAYPOINT_SPACING_VOXELS apart on average; never add one."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if steps.sum() <= fixed.WAYPOINT_SPACING_VOXELS:
        return points
    stride = round(fixed.WAYPOINT_SPACING_VOXELS / float(steps.mean()))
    return points[:: max(stride, 1)]


def _length_before_bend(path: F64) -> int:
    """Return how many points of the path (n, 3) to keep."""
    skipped = fixed.CURVATURE_FROM
    if len(path) <= skipped:
        return len(path)
    first = np.gradient(path, axis=0)
    second = np.gradient(first, axis=0)
    speed = np.linalg.norm(first, axis=1)
    # Where the path stands still, the division gives infinity if it is about to turn and NaN if it is not.
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.linalg.norm(np.cross(first, second), axis=1) / speed**3
    sharp = np.flatnonzero(curvature[skipped:] > fixed.MAX_CURVATURE)
    return int(fixed.KEPT_BEFORE_BEND * (sharp[0] + skipped)) if len(sharp) else len(path)
