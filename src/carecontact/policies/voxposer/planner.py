"""From maps to a path: costs over the voxels, a greedy walk down them, smoothing.

After the release's planners.py and what interfaces.py does to the avoidance map before; docs/voxposer.md lists what is
not as there.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Voxel

Bool = npt.NDArray[np.bool_]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

# Ship no types.
ndimage: Any = import_module("scipy.ndimage")
signal: Any = import_module("scipy.signal")

_REACH = range(-fixed.NEIGHBOUR_VOXELS, fixed.NEIGHBOUR_VOXELS + 1)
_STEPS = np.array([step for step in product(_REACH, repeat=3) if any(step)])
"""The 124 neighbours."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    waypoints: F64
    """(n, 3) voxels, fractions allowed; the tool's own voxel left out, a target voxel last"""
    cost: F32
    """(MAP_SIZE,) * 3, 0 to 1"""
    distance: F32
    """(MAP_SIZE,) * 3 to the nearest target [voxel]"""
    avoidance: F32
    """(MAP_SIZE,) * 3 as the planner used it: what the program wrote and the scene"""


def goals(target: F32) -> I64:
    """(n, 3) voxels to go to: those with the value 1."""
    return np.argwhere(target >= 1)


def distance_to(target: F32) -> F32:
    """(MAP_SIZE,) * 3 of each voxel to the nearest one with the value 1 [voxel].

    Raises ValueError if there is none.
    """
    free = target < 1
    if free.all():
        raise ValueError("no voxel of the affordance map is 1")
    return np.asarray(ndimage.distance_transform_edt(free), np.float32)


def plan(start: Voxel, target: F32, written_avoidance: F32, scene: Bool) -> Plan:
    """From ``start`` to the voxels where ``target`` is 1, round what is to be avoided.

    ``written_avoidance``: from the program; ``scene``: occupied voxels, which count as 1 away from target and tool.
    Raises ValueError for an empty target.
    """
    distance = distance_to(target)
    blocked = scene & (distance >= fixed.TARGET_FREE_VOXELS)
    blocked[_cube(start, fixed.START_FREE_VOXELS)] = False
    avoidance = np.clip(written_avoidance + blocked, 0.0, 1.0)
    spread: F32 = ndimage.gaussian_filter(avoidance, fixed.AVOIDANCE_SIGMA_VOXELS)
    both = fixed.AFFORDANCE_WEIGHT * _normalised(distance) + fixed.AVOIDANCE_WEIGHT * _normalised(spread)
    cost = _normalised(both.astype(np.float32))
    path = _walk(start, cost)
    return Plan(waypoints=_waypoints(path, target), cost=cost, distance=distance, avoidance=avoidance)


def _walk(start: Voxel, cost: F32) -> I64:
    """(n, 3) voxels, at least two, from ``start`` to the cheapest neighbour until all neighbours are dearer."""
    changed = cost.astype(np.float64)
    here = np.array(start)
    path, near = [here], _neighbours(here)
    for _ in range(fixed.MAX_STEPS):
        following = near[int(changed[tuple(near.T)].argmin())]
        changed[tuple(here)] += fixed.VISITED_PENALTY
        here = following
        path.append(here)
        near = _neighbours(here)
        if float(changed[tuple(near.T)].min()) >= float(changed[tuple(here)]) + fixed.STOP_THRESHOLD:
            break
    return np.array(path)


def _neighbours(here: I64) -> I64:
    """(n, 3), each once; at the border those outside are moved onto it."""
    near = here + _STEPS
    inside = np.clip(near, 0, fixed.MAP_SIZE - 1)
    return near if (near == inside).all() else np.unique(inside, axis=0)


def _waypoints(path: I64, target: F32) -> F64:
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
    """Every n-th, so that they are WAYPOINT_SPACING_VOXELS apart on average; never more than there are."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if steps.sum() <= fixed.WAYPOINT_SPACING_VOXELS:
        return points
    stride = round(fixed.WAYPOINT_SPACING_VOXELS / float(steps.mean()))
    return points[:: max(stride, 1)]


def _length_before_bend(path: F64) -> int:
    """Number of points to keep."""
    skipped = fixed.CURVATURE_FROM
    if len(path) <= skipped:
        return len(path)
    first = np.gradient(path, axis=0)
    second = np.gradient(first, axis=0)
    speed = np.linalg.norm(first, axis=1)
    # Where the path stands still: sharp if it is about to turn, straight if not.
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.linalg.norm(np.cross(first, second), axis=1) / speed**3
    sharp = np.flatnonzero(curvature[skipped:] > fixed.MAX_CURVATURE)
    return int(fixed.KEPT_BEFORE_BEND * (sharp[0] + skipped)) if len(sharp) else len(path)


def _cube(centre: Voxel, half: int) -> tuple[slice, ...]:
    return tuple(slice(max(c - half, 0), c + half) for c in centre)


def _normalised(values: F32) -> F32:
    low, high = float(values.min()), float(values.max())
    return np.zeros_like(values) if high - low < 1e-12 else ((values - low) / (high - low)).astype(np.float32)
