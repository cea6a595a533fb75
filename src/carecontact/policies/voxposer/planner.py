"""From maps to a path: costs over the voxels, a greedy walk down them, smoothing."""

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

_STEPS = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])
"""The 26 neighbours."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    waypoints: F64
    """(n, 3) voxels, fractions allowed; the tool's own voxel left out"""
    cost: F32
    """(MAP_SIZE,) * 3, 0 to 1"""
    distance: F32
    """(MAP_SIZE,) * 3 to the nearest target [voxel]"""
    avoidance: F32
    """(MAP_SIZE,) * 3 as the planner used it: what the program wrote and the scene"""


def distance_to(target: F32) -> F32:
    """(MAP_SIZE,) * 3 of each voxel to the nearest one with a positive value [voxel].

    Raises ValueError if there is none.
    """
    free = target <= 0
    if free.all():
        raise ValueError("the affordance map is empty")
    return np.asarray(ndimage.distance_transform_edt(free), np.float32)


def plan(start: Voxel, target: F32, written_avoidance: F32, scene: Bool) -> Plan:
    """From ``start`` to the voxels with a positive ``target``, round what is to be avoided.

    ``written_avoidance``: from the program; ``scene``: occupied voxels, which count as 1 away from target and tool.
    Raises ValueError for an empty target.
    """
    distance = distance_to(target)
    avoidance = written_avoidance.copy()
    blocked = scene & (distance >= fixed.FREE_RADIUS_VOXELS) & ~_ball(start, fixed.FREE_RADIUS_VOXELS, target.shape)
    avoidance[blocked] += 1.0
    np.clip(avoidance, -1.0, 1.0, out=avoidance)
    spread: F32 = ndimage.gaussian_filter(avoidance, fixed.AVOIDANCE_SIGMA_VOXELS, mode="nearest")
    both = fixed.AFFORDANCE_WEIGHT * _normalised(distance) + fixed.AVOIDANCE_WEIGHT * _normalised(spread)
    cost = _normalised(both.astype(np.float32))
    path = _walk(start, cost)
    return Plan(waypoints=_waypoints(path, distance, target), cost=cost, distance=distance, avoidance=avoidance)


def _walk(start: Voxel, cost: F32) -> I64:
    """(n, 3) voxels from ``start`` downhill until no neighbour is better."""
    here, path = np.array(start), [np.array(start)]
    penalty: dict[Voxel, float] = {}
    for _ in range(fixed.MAX_STEPS):
        near = here + _STEPS
        near = near[((near >= 0) & (near < np.array(cost.shape))).all(axis=1)]
        values = cost[tuple(near.T)].astype(np.float64)
        values += np.array([penalty.get((a, b, c), 0.0) for a, b, c in near.tolist()])
        if float(cost[tuple(here)]) <= float(values.min()) + fixed.STOP_THRESHOLD:
            break
        a, b, c = here.tolist()
        penalty[a, b, c] = fixed.VISITED_PENALTY
        here = near[int(values.argmin())]
        path.append(here)
    return np.array(path)


def _waypoints(path: I64, distance: F32, target: F32) -> F64:
    smooth = path.astype(np.float64)
    window = min(fixed.SMOOTHING_WINDOW, len(path))
    if window > fixed.SMOOTHING_ORDER:
        smooth = np.asarray(
            signal.savgol_filter(smooth, window, fixed.SMOOTHING_ORDER, axis=0, mode="interp"), np.float64
        )
        smooth = smooth[: _first_sharp_bend(smooth)]
    points = list(smooth[fixed.PATH_STRIDE :: fixed.PATH_STRIDE])
    end = path[min(len(smooth), len(path)) - 1]
    if distance[tuple(end)] <= fixed.SNAP_VOXELS:
        goals = np.argwhere(target > 0)
        points.append(goals[int(np.linalg.norm(goals - end, axis=1).argmin())].astype(np.float64))
    elif len(smooth) > 1:
        points.append(smooth[-1])
    return np.array(points).reshape(-1, 3)


def _first_sharp_bend(path: F64) -> int:
    """Number of points to keep."""
    if len(path) < 3:
        return len(path)
    first, second = np.gradient(path, axis=0), np.gradient(np.gradient(path, axis=0), axis=0)
    speed = np.linalg.norm(first, axis=1)
    curvature = np.linalg.norm(np.cross(first, second), axis=1) / np.maximum(speed, 1e-6) ** 3
    sharp = np.flatnonzero(curvature > fixed.MAX_CURVATURE)
    return int(sharp[0]) if len(sharp) and sharp[0] > 0 else len(path)


def _ball(centre: Voxel, radius: float, shape: tuple[int, ...]) -> Bool:
    square = sum(
        ((np.arange(n) - c) ** 2).reshape([-1 if k == axis else 1 for k in range(3)])
        for axis, (n, c) in enumerate(zip(shape, centre, strict=True))
    )
    return np.asarray(square < radius**2)


def _normalised(values: F32) -> F32:
    low, high = float(values.min()), float(values.max())
    return np.zeros_like(values) if high - low < 1e-12 else ((values - low) / (high - low)).astype(np.float32)
