"""What the recording keeps of a plan: its path, and for the first plan of a motion slices of its maps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import pixels
from carecontact.contract.observation import CameraView
from carecontact.policies.voxposer.execution import MapQuery
from carecontact.policies.voxposer.executor import manner
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import MapKind, ValueMap
from carecontact.policies.voxposer.planner import Plan, goals

F64 = npt.NDArray[np.float64]
NOTED_ROWS = 50
"""Rows of a map, or target voxels, that are kept at most."""


def path_notes(
    made: Plan, target: npt.NDArray[np.float32], *, tool_m: F64, grid: Grid, view: CameraView
) -> dict[str, object]:
    """Return the notes of every plan: the path from the tool (3,) on, and the middle of the target, in base [m]."""
    path = np.vstack([tool_m, grid.points(made.waypoints)])
    return {
        "path_m": path.round(4).tolist(),
        "path_px": pixels(path, view.intrinsics, view.pose_camera_in_base).round(1).tolist(),
        "target_m": grid.points(goals(target).mean(axis=0)).round(4).tolist(),
    }


def map_notes(
    made: Plan,
    target: npt.NDArray[np.float32],
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
        "intrinsics": view.intrinsics.tolist(), "pose_camera_in_base": view.pose_camera_in_base.tolist(),
        "maps": {kind: query.query for kind, query in queries.items()},
        "written": {kind: value_map.rows()[:NOTED_ROWS] for kind, value_map in maps.items()},
        "target_voxels": targets[:NOTED_ROWS].tolist(),
        "path_speed_m_s": [said.speed_m_s for said in way], "path_quat": [said.quat for said in way],
        "path_gripper": [said.gripper for said in way],
        "cost_level": made.cost[:, :, z].astype(np.float16), "cost_upright": made.cost[:, y, :].astype(np.float16),
        "distance_level": made.distance[:, :, z].astype(np.float16),
        "avoidance_level": made.avoidance[:, :, z].astype(np.float16),
    }  # fmt: skip
