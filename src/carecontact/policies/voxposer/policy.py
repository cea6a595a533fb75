"""The paper's second method, and the variant that ends with an explicit progress objective."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from inspect import Parameter
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.errors import ConfigError, ContractError, ProgramError
from carecontact.interface.action import Action
from carecontact.interface.body_view import PerceptionFailure, person_points
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.policies.language.completion import Transcript
from carecontact.policies.language.live import transcript_of
from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import Entry, Grid, MapKind, ValueMap, goals
from carecontact.policies.voxposer.planner import Motion, forward_only, map_notes, motion, path_notes, plan
from carecontact.policies.voxposer.programs import (
    EXECUTE,
    HOME,
    VOXPOSER,
    VOXPOSER_PHASED,
    Composers,
    MapQuery,
    Programs,
    PromptSet,
    Roles,
    arguments,
    map_queries,
)
from carecontact.policies.voxposer.sandbox import Sandbox
from carecontact.policies.voxposer.scene import (
    MapFunctions,
    Scene,
    described,
    gap,
    number,
    numbers,
    skin_height,
    text_of,
    touches,
)

F64 = npt.NDArray[np.float64]
CAMERA = "overhead"
logger = logging.getLogger(__name__)


class VoxPoser:
    """Requests programs once, then looks, composes value maps, plans, moves, and repeats; docs/evidence/methods.md.

    If it cannot find a part that a program requests, it ends the trial where it stands and logs the reason. A program
    that is stopped or wrong raises ProgramError, and a language backend that fails raises LanguageError; in both
    cases, the trial counts as a process failure of the method.
    """

    name = "voxposer"
    prompts: PromptSet = VOXPOSER
    authored = "authored.jsonl"
    execute = EXECUTE
    """How a program calls ``execute``."""
    horizon_s = fixed.HORIZON_S
    settle_s = fixed.SETTLE_S

    def __init__(self, *, language: str | Transcript | None = None, record: Path | None = None) -> None:
        """``language``: replay:FILE.jsonl, live:MODEL, or the transcript that answers the prompts; by default the
        shipped completions. ``record``: file to which the completions of a live model are added.

        Raises ConfigError for rules-v1 or a language that cannot be read, DependencyError for live without its package.
        """
        if not isinstance(language, Transcript):
            shipped = resources.files(__package__ or __name__) / "completions" / self.authored
            language = transcript_of(language or f"replay:{shipped}", record=record)
        if language is None:
            raise ConfigError("voxposer needs programs: --language replay:FILE.jsonl or live:MODEL, not rules-v1")
        self.card = PolicyCard(
            name=self.name,
            modalities=("rgb", "depth", "points", "masks", "landmarks"),
            cameras=(CAMERA,),
            control_hz=fixed.CONTROL_HZ,
            language_backend=language.name,
        )
        self._programs = Programs(language, self.prompts)
        self._sandbox: Sandbox | None = None
        self._grid: Grid | None = None

    def configure(self, session: Session) -> None:
        """Lay the grid of voxels over the session's workspace."""
        bounds = session.action_bounds
        self._grid = Grid(low_m=np.array(bounds.workspace_low_m), high_m=np.array(bounds.workspace_high_m))

    def reset(self, instruction: str) -> None:
        """Ask the planner for the subtasks, so that a language backend that fails does so before anything moves."""
        if self._grid is None:
            raise ContractError("reset() was called before configure(): the workspace is not known")
        self._scene = Scene(CAMERA, self._grid)
        self._sandbox = self._sandbox or Sandbox()
        self._sandbox.time.start_over()
        self._roles = Roles(self._programs, self._sandbox, MapFunctions(self._scene, self._grid))
        self._notes: dict[str, object] = {"method": self.name, "camera": CAMERA}
        self._home: F64 | None = None
        self._stretches = self._run()
        subtasks = self._roles.subtasks(instruction)
        self._notes["subtasks"] = subtasks
        self._composers = Composers(self._sandbox, self._roles, subtasks, self._composer_functions())

    def act(self, observation: Observation) -> Sequence[Action]:
        if self._sandbox is None:
            raise ContractError("act() was called before reset()")
        self._sandbox.time.start_over()
        self._scene.look(observation)
        try:
            if self._home is None:
                self._home = observation.pose_tcp_in_base.copy()
                self._composers.rehearse(self._try_execute)
            return next(self._stretches, [Action(done=True)])
        except PerceptionFailure as error:
            logger.warning("%s ends the trial where it stands: %s", self.name, error)
            self._notes["ended_because"] = str(error)
            return [Action(done=True)]

    def take_notes(self) -> dict[str, object]:
        """Return the programs, then for every plan its path, and for the first plan of a motion slices of its maps."""
        calls, notes = self._programs.take_calls(), self._notes
        if calls:
            notes |= {"language": calls, "programs": self._programs.written}
        self._notes = {"method": self.name, "camera": CAMERA}
        return notes if len(notes) > 2 else {}

    def _run(self) -> Iterator[Sequence[Action]]:
        """Yield the actions until the next look, from the observation of the moment."""
        for call in self._composers.moves:
            home = Execution(maps={}, home=self._home)
            current = home if call.function_name == HOME else self._execution(call.args, call.kwargs)
            while (moved := self._move(current)) is not None:
                current.whole = moved.whole
                yield moved.actions

    def _move(self, current: Execution) -> Motion | None:
        """Return the next stretch of a motion, from maps that are composed again; None when the motion is over."""
        grid, tool, view, subtask = self._scene.grid, self._scene.pose_tcp, self._scene.view, self._composers.subtask
        if current.home is not None:
            return None if current.whole else self._homewards(current.home, tool)
        if current.plans >= fixed.MAX_PLANS:
            return None
        maps: dict[MapKind, ValueMap] = {kind: self._roles.value_map(query) for kind, query in current.maps.items()}
        here = grid.voxel(tool[:3])
        # Without a map of where to go, the tool stays in its place, because a call may only turn it.
        stay = ValueMap(kind="affordance", entries=[Entry(here, 0.0, (1.0,))])
        target = maps.get("affordance", stay).dense(grid)
        if not len(goals(target)):
            raise ProgramError(f"no voxel of the affordance map of {subtask!r} is 1: there is nowhere to go")
        made = plan(here, target, maps.get("avoidance", ValueMap(kind="avoidance")).dense(grid), self._scene.occupied())
        if current.whole and made.distance[here] <= fixed.REACHED_VOXELS:
            return None
        current.plans += 1
        self._notes |= {"subtask": subtask, "plan": current.plans}
        self._notes |= path_notes(made, target, tool_m=tool[:3], grid=grid, view=view)
        if current.plans == 1:
            self._notes |= map_notes(made, target, queries=current.maps, maps=maps, grid=grid, view=view)
        way = forward_only(grid.points(made.waypoints), tool[:3])
        return motion(way, tool, grid=grid, maps=maps, horizon_s=self.horizon_s, settle_s=self.settle_s)

    def _homewards(self, home: F64, tool: F64) -> Motion:
        """Move from ``tool`` (7,) straight back to the pose ``home`` (7,) in one stretch, both in base."""
        grid, quat = self._scene.grid, tuple(home[3:].tolist())
        turn = ValueMap(kind="rotation", entries=[Entry(grid.voxel(home[:3]), fixed.RADIUS_LIMIT_CM, quat)])
        way = np.clip(home[None, :3], grid.low_m, grid.high_m)
        limit_s = fixed.HOME_LIMIT_S
        return motion(way, tool, grid=grid, maps={"rotation": turn}, horizon_s=limit_s, settle_s=self.settle_s)

    def _execution(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Execution:
        """Return what a call of ``execute`` requests. Raises ProgramError for arguments that it does not take."""
        given = arguments(self.execute, args, kwargs)
        progress = given.get("progress")
        if progress is not None and not isinstance(progress, ProgressQuery):
            raise ProgramError(f"execute: progress expects what {ROLE} returns, got {described(progress)}")
        return Execution(maps=map_queries(given), progress=progress)

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        return self._roles.composer_functions()

    def _try_execute(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """Compose everything that a call of ``execute`` would use, without moving."""
        try:
            execution = self._execution(args, kwargs)
        except ProgramError as error:
            # A ValueError is reported with the program's name and line, as a mistake in every other call is.
            raise ValueError(str(error)) from None
        for query in execution.maps.values():
            self._roles.value_map(query)
        if execution.progress is not None:
            self._objective(execution.progress)

    def _objective(self, query: ProgressQuery) -> Objective:
        functions = {**self._roles.map_functions(), **objective_functions(self._scene.grid)}
        made = self._roles.result(ROLE, query.query, functions)
        if not isinstance(made, Objective):
            raise ProgramError(f"program {ROLE}: {query.query} leaves no objective in ret_val")
        return made


@dataclass(frozen=True, kw_only=True)
class Objective:
    kind: Literal["slide", "displace"]
    direction: F64
    """(3,) level unit vector in base."""
    distance_m: float
    """Way that a slide makes in all, or displacement that a push reaches."""
    span_m: float = 0.0
    """Length of a slide from end to end."""


def objective_functions(grid: Grid) -> dict[str, Callable[..., object]]:
    """Return ``slide`` and ``displace``, which programs call to make an objective."""

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


class Pursuit:
    """An objective from the moment of touching on; ``next_motion`` is called once at each look."""

    def __init__(self, *, objective: Objective, skin: F64, start: F64) -> None:
        """
        Args:
            skin: (N, 3) the person as seen before the arm came near, in base [m].
            start: (3,) the tool when it touched, in base [m].
        """
        self.objective, self._skin, self._start = objective, skin, start
        self.done_m = 0.0
        """How much of the objective's distance is done."""
        self._motions = self._slide() if objective.kind == "slide" else self._displace()

    def next_motion(self, pose_tcp: F64, grid: Grid) -> Motion | None:
        """Return the motion until the next look for a tool (7,) in base; None once the objective is met or given up."""
        self._pose, self._grid = pose_tcp, grid
        return next(self._motions, None)

    def _slide(self) -> Iterator[Motion]:
        last = self._start
        for look in range(fixed.MAX_PROGRESS_LOOKS + 1):
            tool = self._pose[:3]
            self.done_m += abs(float((tool - last) @ self.objective.direction))
            if self.done_m >= self.objective.distance_m or look == fixed.MAX_PROGRESS_LOOKS:
                return
            last = tool.copy()
            goal = self._start + self.objective.span_m / 2 * (-1) ** look * self.objective.direction
            count = max(2, int(np.ceil(np.linalg.norm((goal - tool)[:2]) / fixed.SKIN_RADIUS_M)))
            way = tool + np.linspace(0, 1, count + 1)[1:, None] * (goal - tool)
            for point in way:
                point[2] = skin_height(self._skin, point) - fixed.PRESS_M
            yield _steady(way, self._pose, self._grid, fixed.SLIDE_SPEED_M_S, fixed.HOME_LIMIT_S)

    def _displace(self) -> Iterator[Motion]:
        along, lead_m = self.objective.direction, 0.0
        gap_m, commanded, held = gap(self._skin, self._start, along), None, False
        for look in range(fixed.MAX_PROGRESS_LOOKS + 1):
            self.done_m = float((self._pose[:3] - self._start) @ along) - gap_m
            if held or look == fixed.MAX_PROGRESS_LOOKS:
                return
            if self.done_m >= self.objective.distance_m and commanded is not None:
                # The target is held, not its lead: a tool that nothing stops reaches it and goes no further.
                held, count = True, round(fixed.DISPLACE_HOLD_S * fixed.CONTROL_HZ)
                yield Motion(actions=[commanded] * count, whole=True)
                continue
            lead_m = min(lead_m + fixed.LEAD_STEP_M, fixed.LEAD_LIMIT_M)
            goal = self._pose[:3] + lead_m * along
            goal[2] = self._start[2]
            moved = _steady(goal[None], self._pose, self._grid, fixed.DISPLACE_SPEED_M_S, fixed.HORIZON_S)
            commanded = moved.actions[-1]
            yield Motion(actions=moved.actions, whole=True)


def _steady(way: F64, pose_tcp: F64, grid: Grid, speed_m_s: float, horizon_s: float) -> Motion:
    middle = fixed.MAP_SIZE // 2
    everywhere = Entry((middle, middle, middle), fixed.RADIUS_LIMIT_CM, (speed_m_s / fixed.FULL_SPEED_M_S,))
    pace = ValueMap(kind="velocity", entries=[everywhere])
    return motion(way, pose_tcp, grid=grid, maps={"velocity": pace}, horizon_s=horizon_s)


ROLE = "get_progress"


@dataclass(frozen=True)
class ProgressQuery:
    """An objective as a program holds it: a description of what is to be achieved."""

    query: str
    description = "objective"


@dataclass(kw_only=True)
class Execution:
    """One call of ``execute`` or ``reset_to_default_pose`` that the robot is carrying out."""

    maps: dict[MapKind, MapQuery]
    home: F64 | None = None
    """(7,) pose to return to in base, for ``reset_to_default_pose``; None: follow the maps."""
    progress: ProgressQuery | None = None
    """Only of voxposer-phased."""
    plans: int = 0
    whole: bool = False
    """Whether the last motion went to the end of its path."""
    pursuit: Pursuit | None = None


class VoxPoserPhased(VoxPoser):
    """Works as VoxPoser, but a call of ``execute`` may carry an objective that replaces the maps once the tool touches.

    The method feels nothing: it takes the touch from where the skin was seen before the arm came near, or from the end
    of the value maps' own motion. See docs/evidence/methods.md.
    """

    name = "voxposer-phased"
    prompts: PromptSet = VOXPOSER_PHASED
    authored = "authored-phased.jsonl"
    execute = EXECUTE.replace(
        parameters=[*EXECUTE.parameters.values(), Parameter("progress", Parameter.KEYWORD_ONLY, default=None)]
    )

    def reset(self, instruction: str) -> None:
        super().reset(instruction)
        self._skin: F64 | None = None

    def act(self, observation: Observation) -> Sequence[Action]:
        if self._skin is None:
            self._skin = person_points(observation.cameras[CAMERA])
        return super().act(observation)

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        def progress(query: object) -> object:
            return ClassInstance(ProgressQuery(text_of(query)))

        return super()._composer_functions() | {ROLE: progress}

    def _move(self, current: Execution) -> Motion | None:
        if current.progress is None:
            return super()._move(current)
        tool, pursuit = self._scene.pose_tcp, current.pursuit
        assert self._skin is not None
        if pursuit is None:
            if not touches(self._skin, tool[:3]) and (motion := super()._move(current)) is not None:
                return motion
            objective = self._objective(current.progress)
            pursuit = current.pursuit = Pursuit(objective=objective, skin=self._skin, start=tool[:3].copy())
        moved = pursuit.next_motion(tool, self._scene.grid)
        self._notes |= {
            "subtask": self._composers.subtask,
            "progress": current.progress.query,
            "progress_m": round(pursuit.done_m, 4),
            "progress_of_m": pursuit.objective.distance_m,
            "pursuing": moved is not None,
        }
        return moved
