"""The paper's second method, and the variant that ends with an explicit progress objective."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
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
from carecontact.policies.voxposer.maps import Grid, ValueMap
from carecontact.policies.voxposer.planner import Motion, motion, next_stretch
from carecontact.policies.voxposer.programs import (
    EXECUTE,
    HOME,
    VOXPOSER,
    VOXPOSER_PHASED,
    Composers,
    Execution,
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

# VoxPoser as a policy: it requests programs once, then looks, composes maps, plans, moves a little, and repeats.

F64 = npt.NDArray[np.float64]
CAMERA = "overhead"
logger = logging.getLogger(__name__)


class VoxPoser:
    """Follows value maps from programs that a language model wrote; see docs/voxposer.md.

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
        """
        Args:
            language: replay:FILE.jsonl, live:MODEL, or the transcript itself, which answers the prompts; by default the
                shipped completions that were written by hand.
            record: file to which the completions of a live model are added.

        Raises ConfigError for rules-v1 or a language that cannot be read, DependencyError for live without its package.
        """
        if not isinstance(language, Transcript):
            shipped = resources.files(__package__ or __name__) / "completions" / self.authored
            language = _transcript(language or f"replay:{shipped}", record)
        self._transcript = language
        self.card = PolicyCard(
            name=self.name,
            modalities=("rgb", "depth", "points", "masks", "landmarks"),
            cameras=(CAMERA,),
            control_hz=fixed.CONTROL_HZ,
            language_backend=self._transcript.name,
        )
        self._programs = Programs(self._transcript, self.prompts)
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
        self._current: Execution | None = None
        subtasks = self._roles.subtasks(instruction)
        self._notes["subtasks"] = subtasks
        self._composers = Composers(self._sandbox, self._roles, subtasks, self._composer_functions())

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the actions until the next look: at most ``horizon_s``, and ``settle_s`` more at the end of a path."""
        if self._sandbox is None:
            raise ContractError("act() was called before reset()")
        self._sandbox.time.start_over()
        self._scene.look(observation)
        try:
            if self._home is None:
                self._home = observation.pose_tcp_in_base.copy()
                self._composers.rehearse(self._try_execute)
            return self._next_actions()
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

    def _next_actions(self) -> Sequence[Action]:
        while True:
            if self._current is None:
                pause = self._composers.next_move()
                if pause is None:
                    return [Action(done=True)]
                home = pause.function == HOME
                self._current = (
                    Execution(maps={}, home=self._home) if home else self._execution(pause.args, pause.kwargs)
                )
            moved = self._move(self._current)
            if moved is not None:
                self._current.whole = moved.whole
                return moved.actions
            self._current = None

    def _move(self, current: Execution) -> Motion | None:
        """Return the next stretch of a motion; None when the motion is over."""
        return next_stretch(
            current, self._scene, self._roles, self._notes,
            subtask=self._composers.subtask, horizon_s=self.horizon_s, settle_s=self.settle_s,
        )  # fmt: skip

    def _execution(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Execution:
        """Return what a call of ``execute`` requests. Raises ProgramError for arguments that it does not take."""
        return Execution(maps=map_queries(arguments(self.execute, args, kwargs)))

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        return self._roles.composer_functions()

    def _try_execute(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        try:
            execution = self._execution(args, kwargs)
        except ProgramError as error:
            # A ValueError is reported with the program's name and line, as a mistake in every other call is.
            raise ValueError(str(error)) from None
        self._try(execution)

    def _try(self, execution: Execution) -> None:
        """Compose everything that a call of ``execute`` would use, without moving."""
        for query in execution.maps.values():
            self._roles.value_map(query)


def _transcript(language: str, record: Path | None) -> Transcript:
    transcript = transcript_of(language, record=record)
    if transcript is None:
        raise ConfigError("voxposer needs programs: --language replay:FILE.jsonl or live:MODEL, not rules-v1")
    return transcript


# What voxposer-phased pursues once the tool touches: a way to slide or a distance to push, read from the encoders.


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


# ``voxposer-phased``: value maps lead up to the touch, then a progress objective leads; nothing measures force.

ROLE = "get_progress"


@dataclass(frozen=True)
class ProgressQuery:
    """An objective as a program holds it: a description of what is to be achieved."""

    query: str
    description = "objective"


@dataclass(kw_only=True)
class PhasedExecution(Execution):
    """A call of ``execute`` that may carry a progress objective."""

    progress: ProgressQuery | None = None
    pursuit: Pursuit | None = None


class VoxPoserPhased(VoxPoser):
    """Works as VoxPoser, but a call of ``execute`` may carry an objective that replaces the maps once the tool touches.

    The method feels nothing: it takes the touch from where the skin was seen before the arm came near, or from the end
    of the value maps' own motion. See docs/voxposer-phased.md.
    """

    name = "voxposer-phased"
    prompts: PromptSet = VOXPOSER_PHASED
    authored = "authored-phased.jsonl"
    execute = EXECUTE.replace(
        parameters=[*EXECUTE.parameters.values(), Parameter("progress", Parameter.KEYWORD_ONLY, default=None)]
    )

    def reset(self, instruction: str) -> None:
        """Ask the planner for the subtasks, as VoxPoser does."""
        super().reset(instruction)
        self._skin: F64 | None = None

    def act(self, observation: Observation) -> Sequence[Action]:
        """Keep the skin of the first look, and act as VoxPoser does."""
        if self._skin is None:
            self._skin = person_points(observation.cameras[CAMERA])
        return super().act(observation)

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        def progress(query: object) -> object:
            return ClassInstance(ProgressQuery(text_of(query)))

        return super()._composer_functions() | {ROLE: progress}

    def _execution(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> PhasedExecution:
        progress = arguments(self.execute, args, kwargs).get("progress")
        if progress is not None and not isinstance(progress, ProgressQuery):
            raise ProgramError(f"execute: progress expects what {ROLE} returns, got {described(progress)}")
        return PhasedExecution(maps=super()._execution(args, kwargs).maps, progress=progress)

    def _try(self, execution: Execution) -> None:
        super()._try(execution)
        if isinstance(execution, PhasedExecution) and execution.progress is not None:
            self._objective(execution.progress)

    def _move(self, current: Execution) -> Motion | None:
        if not isinstance(current, PhasedExecution) or current.progress is None:
            return super()._move(current)
        tool = self._scene.pose_tcp
        assert self._skin is not None
        if current.pursuit is None:
            if not touches(self._skin, tool[:3]) and (motion := super()._move(current)) is not None:
                return motion
            current.pursuit = Pursuit(
                objective=self._objective(current.progress), skin=self._skin, start=tool[:3].copy()
            )
        pursuit = current.pursuit
        moved = pursuit.next_motion(tool, self._scene.grid)
        self._notes |= {
            "subtask": self._composers.subtask, "progress": current.progress.query,
            "progress_m": round(pursuit.done_m, 4), "progress_of_m": pursuit.objective.distance_m,
            "pursuing": moved is not None,
        }  # fmt: skip
        return moved

    def _objective(self, query: ProgressQuery) -> Objective:
        functions = {**self._roles.map_functions(), **objective_functions(self._scene.grid)}
        made = self._roles.result(ROLE, query.query, functions)
        if not isinstance(made, Objective):
            raise ProgramError(f"program {ROLE}: {query.query} leaves no objective in ret_val")
        return made
