"""Plans a path through value maps greedily, and follows it with the tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.interface.action import Action
from carecontact.interface.geometry import pixels
from carecontact.interface.observation import CameraView
from carecontact.policies.motion import slerp
from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import Grid, MapKind, ValueMap, Voxel, goals, waypoints
from carecontact.policies.voxposer.programs import MapQuery

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


def plan(start: Voxel, target: F32, written_avoidance: F32, scene: Bool) -> Plan:
    """Find a path from ``start`` to the target that keeps away from what is to be avoided.

    It follows planners.py of the release and what interfaces.py does to the avoidance map; docs/evidence/methods.md
    lists the differences.

    Args:
        start: the tool's voxel.
        target: (MAP_SIZE,) * 3 affordance; voxels with the value 1, at least one, are the target.
        written_avoidance: (MAP_SIZE,) * 3 avoidance that a program wrote.
        scene: (MAP_SIZE,) * 3 occupied voxels; away from target and tool they are avoided with the value 1.
    """
    distance = np.asarray(ndimage.distance_transform_edt(target < 1), np.float32)
    blocked = scene & (distance >= fixed.TARGET_FREE_VOXELS)
    blocked[tuple(slice(max(c - fixed.START_FREE_VOXELS, 0), c + fixed.START_FREE_VOXELS) for c in start)] = False
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


def _normalised(values: F32) -> F32:
    low, high = float(values.min()), float(values.max())
    return np.zeros_like(values) if high - low < 1e-12 else ((values - low) / (high - low)).astype(np.float32)


ROUNDING_S = 1e-9


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What the tool does until the next look."""

    actions: list[Action]
    """One for every period of CONTROL_HZ."""
    whole: bool
    """Whether the actions go to the end of the path, or only as far as the horizon."""


def forward_only(waypoints_m: F64, tool_m: F64) -> F64:
    """Return the (k, 3) waypoints that lead forward, out of (n, 3), for a tool at (3,), all in base [m].

    The last waypoint is kept. Of those before it, one is kept if it lies towards the last one, as seen from the one
    kept before it (or from the tool), until one is within NEAR_END_M of the last. As in the release, the product that
    decides is rounded to 0.001 m^2.
    """
    kept: list[F64] = []
    place, last = tool_m, waypoints_m[-1]
    for waypoint in waypoints_m[:-1]:
        if np.linalg.norm(last - place) <= fixed.NEAR_END_M:
            break
        if round(float((last - place) @ (waypoint - place)), 3) > 0:
            kept.append(waypoint)
            place = waypoint
    return np.array([*kept, last])


@dataclass(frozen=True, kw_only=True)
class Manner:
    """How the tool goes to a waypoint."""

    speed_m_s: float
    quat: tuple[float, ...] | None
    """quat_wxyz at the waypoint; None keeps the present one."""
    gripper: float | None
    """Opening from 0 to 1; None keeps the present one."""


def manner(grid: Grid, place_m: F64, maps: Mapping[MapKind, ValueMap]) -> Manner:
    """Return what the velocity, rotation and gripper maps say for the voxel of a place (3,) in base [m]."""
    at = {kind: value_map.at(grid, place_m) for kind, value_map in maps.items()}
    factor, opening = at.get("velocity") or (1.0,), at.get("gripper")
    speed_m_s = fixed.FULL_SPEED_M_S * float(np.clip(factor[0], fixed.MIN_VELOCITY, 1.0))
    return Manner(speed_m_s=speed_m_s, quat=at.get("rotation"), gripper=None if opening is None else opening[0])


def motion(
    waypoints_m: F64,
    pose_tcp: F64,
    *,
    grid: Grid,
    maps: Mapping[MapKind, ValueMap],
    horizon_s: float = fixed.HORIZON_S,
    settle_s: float = fixed.SETTLE_S,
) -> Motion:
    """Move in straight lines from the tool (7,) through all waypoints (n, 3), at each one's speed, up to the horizon.

    Args:
        waypoints_m: (n, 3) in base [m].
        pose_tcp: (7,) where the tool is: position in base [m], quat_wxyz.
        grid: the voxels of the maps; no target lies outside its box.
        maps: velocity, rotation and gripper maps; others are ignored.
        horizon_s: length of the motion at most [s].
        settle_s: how long the end of the path is held [s], if the path ends before the horizon.
    """
    position, quat = pose_tcp[:3], pose_tcp[3:]
    budget = round(horizon_s * fixed.CONTROL_HZ)
    actions: list[Action] = []
    began_s = 0.0
    for goal in waypoints_m:
        how = manner(grid, goal, maps)
        turn = quat if how.quat is None else np.array(how.quat)
        angle = 2 * float(np.arccos(np.clip(abs(float(quat @ turn)), 0.0, 1.0)))
        seconds = max(float(np.linalg.norm(goal - position)) / how.speed_m_s, angle / fixed.ROTATION_SPEED_RAD_S)
        while (since_s := (len(actions) + 1) / fixed.CONTROL_HZ - began_s) <= seconds + ROUNDING_S:
            if len(actions) == budget:
                return Motion(actions=actions, whole=False)
            share = min(since_s / seconds, 1.0)
            # The tool may have been pushed out of the workspace; no target may lie there.
            place = np.clip(position + share * (goal - position), grid.low_m, grid.high_m)
            pose = np.concatenate([place, slerp(quat, turn, share)])
            actions.append(Action(pose_tcp_in_base=pose, gripper=how.gripper))
        began_s += seconds
        position, quat = goal, turn
    if len(actions) == budget and began_s > horizon_s + ROUNDING_S:
        return Motion(actions=actions, whole=False)
    last = np.concatenate([np.clip(position, grid.low_m, grid.high_m), quat])
    arriving = int(len(actions) / fixed.CONTROL_HZ < began_s - ROUNDING_S)
    actions += [Action(pose_tcp_in_base=last)] * (arriving + round(settle_s * fixed.CONTROL_HZ))
    return Motion(actions=actions, whole=True)


NOTED_ROWS = 50
"""Rows of a map, or target voxels, that are kept at most."""


def path_notes(made: Plan, target: F32, *, tool_m: F64, grid: Grid, view: CameraView) -> dict[str, object]:
    """Return the notes of every plan: the path from the tool (3,) on, and the middle of the target, in base [m]."""
    path = np.vstack([tool_m, grid.points(made.waypoints)])
    return {
        "path_m": path.round(4).tolist(),
        "path_px": pixels(path, view.intrinsics, view.pose_camera_in_base).round(1).tolist(),
        "target_m": grid.points(goals(target).mean(axis=0)).round(4).tolist(),
    }


def map_notes(
    made: Plan,
    target: F32,
    *,
    queries: Mapping[MapKind, MapQuery],
    maps: Mapping[MapKind, ValueMap],
    grid: Grid,
    view: CameraView,
) -> dict[str, object]:
    """Return the notes of a motion's first plan: what its maps say, and slices of cost, distance and avoidance.

    The level slices (MAP_SIZE, MAP_SIZE) lie at the height of the target, the upright one at its y.
    """
    targets = goals(target)
    _, y, z = np.rint(targets.mean(axis=0)).astype(int).tolist()
    way = [manner(grid, place, maps) for place in grid.points(made.waypoints)]
    return {
        "grid": {"low_m": grid.low_m.tolist(), "high_m": grid.high_m.tolist(), "level": z, "upright": y},
        "intrinsics": view.intrinsics.tolist(),
        "pose_camera_in_base": view.pose_camera_in_base.tolist(),
        "maps": {kind: query.query for kind, query in queries.items()},
        "written": {kind: value_map.rows()[:NOTED_ROWS] for kind, value_map in maps.items()},
        "target_voxels": targets[:NOTED_ROWS].tolist(),
        "path_speed_m_s": [how.speed_m_s for how in way],
        "path_quat": [how.quat for how in way],
        "path_gripper": [how.gripper for how in way],
        "cost_level": made.cost[:, :, z].astype(np.float16),
        "cost_upright": made.cost[:, y, :].astype(np.float16),
        "distance_level": made.distance[:, :, z].astype(np.float16),
        "avoidance_level": made.avoidance[:, :, z].astype(np.float16),
    }
