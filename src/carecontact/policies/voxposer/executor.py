"""Makes a plan's targets until the next look: skips what leads back, keeps to the maps' speeds and turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.policies.motion import slerp
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import MapKind, ValueMap

F64 = npt.NDArray[np.float64]
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
    velocity, rotation, gripper = maps.get("velocity"), maps.get("rotation"), maps.get("gripper")
    factor = (velocity.at(grid, place_m) if velocity else None) or (1.0,)
    opening = gripper.at(grid, place_m) if gripper else None
    return Manner(
        speed_m_s=fixed.FULL_SPEED_M_S * float(np.clip(factor[0], fixed.MIN_VELOCITY, 1.0)),
        quat=rotation.at(grid, place_m) if rotation else None,
        gripper=None if opening is None else opening[0],
    )


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
        said = manner(grid, goal, maps)
        turn = quat if said.quat is None else np.array(said.quat)
        angle = 2 * float(np.arccos(np.clip(abs(float(quat @ turn)), 0.0, 1.0)))
        seconds = max(float(np.linalg.norm(goal - position)) / said.speed_m_s, angle / fixed.ROTATION_SPEED_RAD_S)
        while (since_s := (len(actions) + 1) / fixed.CONTROL_HZ - began_s) <= seconds + ROUNDING_S:
            if len(actions) == budget:
                return Motion(actions=actions, whole=False)
            share = min(since_s / seconds, 1.0)
            # The tool may have been pushed out of the workspace; no target may lie there.
            place = np.clip(position + share * (goal - position), grid.low_m, grid.high_m)
            pose = np.concatenate([place, slerp(quat, turn, share)])
            actions.append(Action(pose_tcp_in_base=pose, gripper=said.gripper))
        began_s += seconds
        position, quat = goal, turn
    if len(actions) == budget and began_s > horizon_s + ROUNDING_S:
        return Motion(actions=actions, whole=False)
    last = np.concatenate([np.clip(position, grid.low_m, grid.high_m), quat])
    arriving = int(len(actions) / fixed.CONTROL_HZ < began_s - ROUNDING_S)
    actions += [Action(pose_tcp_in_base=last)] * (arriving + round(settle_s * fixed.CONTROL_HZ))
    return Motion(actions=actions, whole=True)


def homewards(home: F64, pose_tcp: F64, *, grid: Grid, settle_s: float) -> Motion:
    """Move from ``pose_tcp`` (7,) straight back to the pose ``home`` (7,) in one stretch, both in base."""
    turn = ValueMap(kind="rotation")
    turn.add(grid.voxel(home[:3]), tuple(home[3:].tolist()), radius_cm=fixed.RADIUS_LIMIT_CM)
    way = np.clip(home[None, :3], grid.low_m, grid.high_m)
    return motion(way, pose_tcp, grid=grid, maps={"rotation": turn}, horizon_s=fixed.HOME_LIMIT_S, settle_s=settle_s)
