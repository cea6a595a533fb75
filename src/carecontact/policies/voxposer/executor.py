"""From a plan to targets for the next moment: skip what leads back, keep to the maps' speeds and turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.policies.motion import slerp
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import ValueMap

F64 = npt.NDArray[np.float64]
ROUNDING_S = 1e-9


@dataclass(frozen=True, kw_only=True)
class Motion:
    actions: list[Action]
    """At CONTROL_HZ"""
    whole: bool
    """Whether they go to the end of the path, or only as far as the horizon."""


def forward_only(waypoints_m: F64, tool_m: F64) -> F64:
    """(n, 3) -> (k, 3): the last one, and before it those that lie towards it, seen from the one gone to before (or the
    tool), until one is NEAR_END_M from it. The release, too, rounds the product that decides to 0.001 m^2."""
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
    """wxyz; None: as it is"""
    gripper: float | None


def manner(
    grid: Grid, place_m: F64, *, velocity: ValueMap | None, rotation: ValueMap | None, gripper: ValueMap | None
) -> Manner:
    """What the maps say for the voxel of a place (3,)."""
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
    velocity: ValueMap | None,
    rotation: ValueMap | None,
    gripper: ValueMap | None,
    horizon_s: float = fixed.HORIZON_S,
    settle_s: float = fixed.SETTLE_S,
) -> Motion:
    """Straight lines from the tool (7,) through all waypoints (n, 3), at each one's speed, up to the horizon.

    A path that ends before it is held at its end for ``settle_s``.
    """
    position, quat = pose_tcp[:3], pose_tcp[3:]
    budget = round(horizon_s * fixed.CONTROL_HZ)
    actions: list[Action] = []
    began_s = 0.0
    for goal in waypoints_m:
        said = manner(grid, goal, velocity=velocity, rotation=rotation, gripper=gripper)
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
