"""What voxposer-phased pursues once the tool touches: a way to slide or a distance to push, told by the encoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.action import Action
from carecontact.policies.motion import CAP_RADIUS_M
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.executor import Motion, motion
from carecontact.policies.voxposer.functions import number, numbers
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import ValueMap

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Objective:
    kind: Literal["slide", "displace"]
    direction: F64
    """(3,) unit, level, in base"""
    distance_m: float
    span_m: float = 0.0
    """Of a slide, from end to end."""


def objective_functions(grid: Grid) -> dict[str, Callable[..., object]]:
    """``slide`` and ``displace`` for programs."""

    def made(kind: Literal["slide", "displace"], direction: object, distance_cm: object, span_cm: object) -> object:
        way = numbers(direction, 3, "direction") * grid.pitch_m * [1.0, 1.0, 0.0]
        length = float(np.linalg.norm(way))
        if length < 1e-9:
            raise ValueError(f"{kind}: a level direction of length 0")
        distance, span = number(distance_cm, "distance_cm"), number(span_cm, "span_cm")
        if not 0 < distance <= fixed.MAX_DISTANCE_CM or not 0 <= span <= fixed.MAX_DISTANCE_CM:
            raise ValueError(f"{kind}: distances are more than 0 and at most {fixed.MAX_DISTANCE_CM:g} cm")
        objective = Objective(kind=kind, direction=way / length, distance_m=distance / 100, span_m=span / 100)
        return ClassInstance(objective)

    def slide(direction: object, distance_cm: object, span_cm: object) -> object:
        return made("slide", direction, distance_cm, span_cm)

    def displace(direction: object, distance_cm: object) -> object:
        return made("displace", direction, distance_cm, 0.0)

    return {"slide": slide, "displace": displace}


@dataclass(kw_only=True)
class Pursuit:
    """An objective from the moment of touching on; one call of ``next_motion`` a look."""

    objective: Objective
    skin: F64
    """(N, 3) the person as seen before the arm came near, in base [m]"""
    start: F64
    """(3,) the tool when it touched"""
    done_m: float = 0.0
    looks: int = 0
    _last: F64 = field(init=False)
    _lead_m: float = 0.0
    _forth: bool = True
    _held: bool = False
    _commanded: Action | None = None
    """The last action of a displacement"""
    _gap_m: float = field(init=False)

    def __post_init__(self) -> None:
        self._last = self.start
        self._gap_m = gap(self.skin, self.start, self.objective.direction) if self.objective.kind == "displace" else 0.0

    def next_motion(self, pose_tcp: F64, grid: Grid) -> Motion | None:
        """(7,) where the tool is now. None: met, held, or given up after MAX_PROGRESS_LOOKS."""
        tool, along = pose_tcp[:3], self.objective.direction
        if self.objective.kind == "slide":
            self.done_m += abs(float((tool - self._last) @ along))
        else:
            self.done_m = float((tool - self.start) @ along) - self._gap_m
        self._last = tool.copy()
        self.looks += 1
        met = self.done_m >= self.objective.distance_m
        if self._held or self.looks > fixed.MAX_PROGRESS_LOOKS or (met and self.objective.kind == "slide"):
            return None
        return self._slide(pose_tcp, grid) if self.objective.kind == "slide" else self._displace(pose_tcp, grid, met)

    def _slide(self, pose_tcp: F64, grid: Grid) -> Motion:
        half = self.objective.span_m / 2 * (1 if self._forth else -1)
        self._forth = not self._forth
        goal = self.start + half * self.objective.direction
        count = max(2, int(np.ceil(np.linalg.norm((goal - pose_tcp[:3])[:2]) / fixed.SKIN_RADIUS_M)))
        way = pose_tcp[:3] + np.linspace(0, 1, count + 1)[1:, None] * (goal - pose_tcp[:3])
        for point in way:
            point[2] = skin_height(self.skin, point) - fixed.PRESS_M
        return _steady(way, pose_tcp, grid, fixed.SLIDE_SPEED_M_S, fixed.HOME_LIMIT_S)

    def _displace(self, pose_tcp: F64, grid: Grid, met: bool) -> Motion:
        if met and self._commanded is not None:
            # Held is the target, not its lead: a tool that nothing stops comes to it and no further.
            self._held = True
            count = round(fixed.DISPLACE_HOLD_S * fixed.CONTROL_HZ)
            return Motion(actions=[self._commanded] * count, whole=True)
        self._lead_m = min(self._lead_m + fixed.LEAD_STEP_M, fixed.LEAD_LIMIT_M)
        goal = pose_tcp[:3] + self._lead_m * self.objective.direction
        goal[2] = self.start[2]
        moved = _steady(goal[None], pose_tcp, grid, fixed.DISPLACE_SPEED_M_S, fixed.HORIZON_S)
        self._commanded = moved.actions[-1]
        return Motion(actions=moved.actions, whole=True)


def touches(skin: F64, tool: F64) -> bool:
    """Whether the round cap at the tool's tip is as near to the skin as can be told without feeling it."""
    centre = tool + [0.0, 0.0, CAP_RADIUS_M]
    return bool(np.linalg.norm(skin - centre, axis=1).min(initial=np.inf) <= CAP_RADIUS_M + fixed.CONTACT_M)


def gap(skin: F64, tool: F64, direction: F64) -> float:
    """[m] that the cap can still go along a level direction before it meets the seen skin; 0 if it is there or if
    nothing is seen on its way."""
    offset = skin - tool
    ahead = offset @ direction
    beside = np.linalg.norm((offset - ahead[:, None] * direction)[:, :2], axis=1) <= CAP_RADIUS_M
    ahead = ahead[beside & (offset[:, 2] >= 0) & (ahead > 0)]
    return max(float(ahead.min()) - CAP_RADIUS_M, 0.0) if len(ahead) else 0.0


def skin_height(skin: F64, place: F64) -> float:
    """Z [m] of the seen skin above a place; the place's own where nothing was seen."""
    near = skin[np.hypot(*(skin[:, :2] - place[:2]).T) < fixed.SKIN_RADIUS_M, 2]
    return float(np.percentile(near, 90)) if len(near) else float(place[2]) + fixed.PRESS_M


def _steady(way: F64, pose_tcp: F64, grid: Grid, speed_m_s: float, horizon_s: float) -> Motion:
    pace = ValueMap(kind="velocity")
    middle = fixed.MAP_SIZE // 2
    pace.add((middle, middle, middle), (speed_m_s / fixed.FULL_SPEED_M_S,), radius_cm=fixed.RADIUS_LIMIT_CM)
    return motion(way, pose_tcp, grid=grid, velocity=pace, rotation=None, gripper=None, horizon_s=horizon_s)
