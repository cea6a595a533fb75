"""What voxposer-phased pursues once the tool touches: a way to slide or a distance to push, read from the encoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.action import Action
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.arguments import number, numbers
from carecontact.policies.voxposer.executor import Motion, motion
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.maps import ValueMap
from carecontact.policies.voxposer.seen_skin import gap, skin_height

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Objective:
    """What a contact shall achieve."""

    kind: Literal["slide", "displace"]
    direction: F64
    """(3,) level unit vector in base."""
    distance_m: float
    """Way that a slide makes in all, or displacement that a push reaches."""
    span_m: float = 0.0
    """Length of a slide from end to end."""


def objective_functions(grid: Grid) -> dict[str, Callable[..., object]]:
    """Return ``slide`` and ``displace``, which programs call to make an objective.

    Both raise TypeError or ValueError for arguments that they do not take.
    """

    def made(kind: Literal["slide", "displace"], direction: object, distance_cm: object, span_cm: object) -> object:
        way = numbers(direction, 3, "direction") * grid.pitch_m * [1.0, 1.0, 0.0]
        length = float(np.linalg.norm(way))
        if length < 1e-9:
            raise ValueError(f"{kind}: expected a direction with a level part, got one of length 0")
        distance, span = number(distance_cm, "distance_cm"), number(span_cm, "span_cm")
        if not 0 < distance <= fixed.MAX_DISTANCE_CM or not 0 <= span <= fixed.MAX_DISTANCE_CM:
            raise ValueError(f"{kind}: expected distances of more than 0 and at most {fixed.MAX_DISTANCE_CM:g} cm")
        objective = Objective(kind=kind, direction=way / length, distance_m=distance / 100, span_m=span / 100)
        return ClassInstance(objective)

    def slide(direction: object, distance_cm: object, span_cm: object) -> object:
        return made("slide", direction, distance_cm, span_cm)

    def displace(direction: object, distance_cm: object) -> object:
        return made("displace", direction, distance_cm, 0.0)

    return {"slide": slide, "displace": displace}


@dataclass(kw_only=True)
class Pursuit:
    """An objective from the moment of touching on; ``next_motion`` is called once at each look."""

    objective: Objective
    skin: F64
    """(N, 3) the person as seen before the arm came near, in base [m]."""
    start: F64
    """(3,) the tool when it touched, in base [m]."""
    done_m: float = 0.0
    """How much of the objective's distance is done."""
    looks: int = 0
    _last: F64 = field(init=False)
    _lead_m: float = 0.0
    _forth: bool = True
    _held: bool = False
    _commanded: Action | None = None
    """The last action of a displacement."""
    _gap_m: float = field(init=False)

    def __post_init__(self) -> None:
        self._last = self.start
        self._gap_m = gap(self.skin, self.start, self.objective.direction) if self.objective.kind == "displace" else 0.0

    def next_motion(self, pose_tcp: F64, grid: Grid) -> Motion | None:
        """Return the motion until the next look for a tool at ``pose_tcp`` (7,) in base.

        None means that the objective is met (and, for a displacement, was held), or is given up after
        MAX_PROGRESS_LOOKS.
        """
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
            # The target is held, not its lead over the tool: a tool that nothing stops reaches it and goes no further.
            self._held = True
            count = round(fixed.DISPLACE_HOLD_S * fixed.CONTROL_HZ)
            return Motion(actions=[self._commanded] * count, whole=True)
        self._lead_m = min(self._lead_m + fixed.LEAD_STEP_M, fixed.LEAD_LIMIT_M)
        goal = pose_tcp[:3] + self._lead_m * self.objective.direction
        goal[2] = self.start[2]
        moved = _steady(goal[None], pose_tcp, grid, fixed.DISPLACE_SPEED_M_S, fixed.HORIZON_S)
        self._commanded = moved.actions[-1]
        return Motion(actions=moved.actions, whole=True)


def _steady(way: F64, pose_tcp: F64, grid: Grid, speed_m_s: float, horizon_s: float) -> Motion:
    pace = ValueMap(kind="velocity")
    middle = fixed.MAP_SIZE // 2
    pace.add((middle, middle, middle), (speed_m_s / fixed.FULL_SPEED_M_S,), radius_cm=fixed.RADIUS_LIMIT_CM)
    return motion(way, pose_tcp, grid=grid, maps={"velocity": pace}, horizon_s=horizon_s)
