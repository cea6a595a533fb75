"""The next stretch of one call of ``execute``: compose its maps from the latest look, plan, and move a little."""

from __future__ import annotations

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.execution import Execution
from carecontact.policies.voxposer.executor import Motion, forward_only, homewards, motion
from carecontact.policies.voxposer.maps import MapKind, ValueMap
from carecontact.policies.voxposer.plan_notes import map_notes, path_notes
from carecontact.policies.voxposer.planner import plan, target_of
from carecontact.policies.voxposer.roles import Roles
from carecontact.policies.voxposer.scene import Scene


def next_stretch(
    current: Execution,
    scene: Scene,
    roles: Roles,
    notes: dict[str, object],
    *,
    subtask: str,
    horizon_s: float,
    settle_s: float,
) -> Motion | None:
    """Return the next stretch of a motion; None when the motion is over.

    Args:
        current: the call that the robot carries out; its plans are counted here.
        scene: what is seen now.
        roles: composes the maps.
        notes: what is written down of the plan is added here.
        subtask: what the motion is for, as errors and notes name it.
        horizon_s: length of the stretch at most [s].
        settle_s: how long the end of a path is held [s].

    Raises:
        ProgramError: a program that composes a map is stopped or wrong.
        PerceptionFailure: a part that a program requests has never been seen.
    """
    grid, tool, view = scene.grid, scene.pose_tcp, scene.view
    if current.home is not None:
        return None if current.whole else homewards(current.home, tool, grid=grid, settle_s=settle_s)
    if current.plans >= fixed.MAX_PLANS:
        return None
    maps: dict[MapKind, ValueMap] = {kind: roles.value_map(query) for kind, query in current.maps.items()}
    target = target_of(maps.get("affordance"), tool, grid, subtask=subtask)
    avoidance = maps.get("avoidance", ValueMap(kind="avoidance")).dense(grid)
    made = plan(grid.voxel(tool[:3]), target, avoidance, scene.occupied())
    if current.whole and made.distance[grid.voxel(tool[:3])] <= fixed.REACHED_VOXELS:
        return None
    current.plans += 1
    notes |= {"subtask": subtask, "plan": current.plans}
    notes |= path_notes(made, target, tool_m=tool[:3], grid=grid, view=view)
    if current.plans == 1:
        notes |= map_notes(made, target, queries=current.maps, maps=maps, grid=grid, view=view)
    waypoints = forward_only(grid.points(made.waypoints), tool[:3])
    return motion(waypoints, tool, grid=grid, maps=maps, horizon_s=horizon_s, settle_s=settle_s)
