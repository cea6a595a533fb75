"""Makes a path of maps: costs over the voxels and a greedy walk down them.

It follows the release's planners.py and what interfaces.py does to the avoidance map before; docs/voxposer.md lists the
differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import ProgramError
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid, Voxel
from carecontact.policies.voxposer.maps import ValueMap, goals
from carecontact.policies.voxposer.smoothing import waypoints

Bool = npt.NDArray[np.bool_]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

# The package ships no types.
ndimage: Any = import_module("scipy.ndimage")

_REACH = range(-fixed.NEIGHBOUR_VOXELS, fixed.NEIGHBOUR_VOXELS + 1)
_STEPS = np.array([step for step in product(_REACH, repeat=3) if any(step)])
"""(124, 3) steps to the neighbours of a voxel."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A path to the target, and the arrays that it was found in."""

    waypoints: F64
    """(n, 3) voxels, with fractions; without the tool's own voxel, and with a target voxel last."""
    cost: F32
    """(MAP_SIZE,) * 3, from 0 to 1."""
    distance: F32
    """(MAP_SIZE,) * 3 distance to the nearest target voxel [voxel]."""
    avoidance: F32
    """(MAP_SIZE,) * 3 as the planner used it: what the program wrote and the scene."""


def target_of(affordance: ValueMap | None, pose_tcp: F64, grid: Grid, *, subtask: str) -> F32:
    """Return the (MAP_SIZE,) * 3 affordance, in which voxels with the value 1 are the target.

    Without a map the tool (7,) stays where it is, because a call may only turn it. Raises ProgramError for a map
    without a target.
    """
    stay = ValueMap(kind="affordance")
    stay.add(grid.voxel(pose_tcp[:3]), (1.0,))
    dense = (affordance or stay).dense(grid)
    if not len(goals(dense)):
        raise ProgramError(f"no voxel of the affordance map of {subtask!r} is 1: there is nowhere to go")
    return dense


def distance_to(target: F32) -> F32:
    """Return the (MAP_SIZE,) * 3 distance of each voxel to the nearest one with the value 1 [voxel].

    Raises ValueError if no voxel has the value 1.
    """
    free = target < 1
    if free.all():
        raise ValueError("no voxel of the affordance map is 1")
    return np.asarray(ndimage.distance_transform_edt(free), np.float32)


def plan(start: Voxel, target: F32, written_avoidance: F32, scene: Bool) -> Plan:
    """Find a path from ``start`` to the target that keeps away from what is to be avoided.

    Args:
        start: the tool's voxel.
        target: (MAP_SIZE,) * 3 affordance; voxels with the value 1 are the target.
        written_avoidance: (MAP_SIZE,) * 3 avoidance that a program wrote.
        scene: (MAP_SIZE,) * 3 occupied voxels; away from target and tool they are avoided with the value 1.

    Raises:
        ValueError: the target is empty.
    """
    distance = distance_to(target)
    blocked = scene & (distance >= fixed.TARGET_FREE_VOXELS)
    blocked[_cube(start, fixed.START_FREE_VOXELS)] = False
    avoidance = np.clip(written_avoidance + blocked, 0.0, 1.0)
    spread: F32 = ndimage.gaussian_filter(avoidance, fixed.AVOIDANCE_SIGMA_VOXELS)
    both = fixed.AFFORDANCE_WEIGHT * _normalised(distance) + fixed.AVOIDANCE_WEIGHT * _normalised(spread)
    cost = _normalised(both.astype(np.float32))
    path = _walk(start, cost)
    return Plan(waypoints=waypoints(path, target), cost=cost, distance=distance, avoidance=avoidance)


def _walk(start: Voxel, cost: F32) -> I64:
    """Return (n, 3) voxels, at least two: from ``start`` to the cheapest neighbour until every neighbour costs more."""
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
    """Return (n, 3) neighbours, each once; those outside the map are moved onto its border."""
    near = here + _STEPS
    inside = np.clip(near, 0, fixed.MAP_SIZE - 1)
    return near if (near == inside).all() else np.unique(inside, axis=0)


def _cube(centre: Voxel, half: int) -> tuple[slice, ...]:
    return tuple(slice(max(c - half, 0), c + half) for c in centre)


def _normalised(values: F32) -> F32:
    low, high = float(values.min()), float(values.max())
    return np.zeros_like(values) if high - low < 1e-12 else ((values - low) / (high - low)).astype(np.float32)
