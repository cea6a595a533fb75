"""The policy itself: programs once, then look, compose maps, plan, move a little, and again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.action import Action
from carecontact.contract.geometry import pixels
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard, Session
from carecontact.errors import ConfigError, ContractError, ProgramError
from carecontact.policies.language.selection import transcript_of
from carecontact.policies.language.transcript import Transcript
from carecontact.policies.region_geometry import PerceptionFailure
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.executor import Motion, forward_only, manner, motion
from carecontact.policies.voxposer.functions import MapFunctions, PartHandle, offered, told
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.lmp import Programs
from carecontact.policies.voxposer.maps import KINDS, MapKind, ValueMap
from carecontact.policies.voxposer.planner import Plan, goals, plan
from carecontact.policies.voxposer.prompts import VOXPOSER, PromptSet
from carecontact.policies.voxposer.sandbox import Functions, PausedProgram, Sandbox, bound
from carecontact.policies.voxposer.scene import GRIPPER, Scene

F64 = npt.NDArray[np.float64]
CAMERA = "overhead"
MOVES = ("execute", "reset_to_default_pose")
"""Calls at which a program waits for the robot."""
NOTED_ROWS = 50
"""Of a map, in the notes."""
_MAPS: dict[str, MapKind] = {f"{kind}_map": kind for kind in KINDS}
EXECUTE = Signature(
    [Parameter("movable", Parameter.POSITIONAL_OR_KEYWORD)]
    + [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None) for name in _MAPS]
)
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class MapQuery:
    """A map as a program holds it: what it shall be. It is composed anew for every plan."""

    kind: MapKind
    query: str

    @property
    def told(self) -> str:
        return f"{self.kind} map"


@dataclass(kw_only=True)
class Execution:
    """One call of ``execute`` or ``reset_to_default_pose`` that the robot is carrying out."""

    maps: dict[MapKind, MapQuery]
    home: bool = False
    plans: int = 0
    whole: bool = False
    """Whether the last motion went to the end of its path."""


class VoxPoser:
    """Value maps from programs that a language model wrote; see docs/voxposer.md.

    If a part that a program asks for cannot be found it ends the trial where it stands, and logs why. A program that is
    stopped or wrong is a ProgramError, a language backend that fails a LanguageError: the method's process failure.
    """

    name = "voxposer"
    prompts: PromptSet = VOXPOSER
    authored = "authored.jsonl"
    execute = EXECUTE
    """How a program calls ``execute``: the release's order, None for what is not given."""
    horizon_s = fixed.HORIZON_S
    settle_s = fixed.SETTLE_S

    def __init__(self, *, language: str | Transcript | None = None, record: Path | None = None) -> None:
        """
        Args:
            language: replay:FILE.jsonl, live:MODEL, or a transcript itself; default: the shipped completions, which a
                person wrote.
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
        bounds = session.action_bounds
        self._grid = Grid(low_m=np.array(bounds.workspace_low_m), high_m=np.array(bounds.workspace_high_m))

    def reset(self, instruction: str) -> None:
        """Asks for the plan, so that a language backend that fails does so before anything moves."""
        if self._grid is None:
            raise ContractError("reset() before configure(): the workspace is not known")
        self._scene = Scene(CAMERA, self._grid)
        self._functions = MapFunctions(self._scene, self._grid)
        self._sandbox = self._sandbox or Sandbox()
        self._sandbox.time.start_over()
        self._notes: dict[str, object] = {"method": self.name, "camera": CAMERA}
        self._home: F64 | None = None
        self._running: PausedProgram | None = None
        self._current: Execution | None = None
        self._subtask = ""
        self._waiting = self._subtasks(instruction)

    def act(self, observation: Observation) -> Sequence[Action]:
        """What is moved until the next look, at most ``horizon_s`` and ``settle_s`` long."""
        if self._sandbox is None:
            raise ContractError("act() before reset()")
        self._sandbox.time.start_over()
        self._scene.look(observation)
        try:
            if self._home is None:
                self._home = observation.pose_tcp_in_base.copy()
                self._rehearse()
            return self._next_actions()
        except PerceptionFailure as error:
            logger.warning("%s ends where it stands: %s", self.name, error)
            self._notes["ended_because"] = str(error)
            return [Action(done=True)]

    def take_notes(self) -> dict[str, object]:
        """Programs, then for every plan its path and, for the first one of a motion, slices of its maps."""
        calls, notes = self._programs.take_calls(), self._notes
        if calls:
            notes |= {"language": calls, "programs": self._programs.written}
        self._notes = {"method": self.name, "camera": CAMERA}
        return notes if len(notes) > 2 else {}

    def _subtasks(self, instruction: str) -> list[str]:
        found: list[str] = []

        def composer(query: object) -> None:
            if len(found) >= fixed.MAX_SUBTASKS:
                raise ValueError(f"composer: expected at most {fixed.MAX_SUBTASKS} texts")
            found.append(text_of(query))

        name = f"planner: {instruction}"
        self._box.run(name, self._program("planner", instruction), {"composer": composer})
        if not found:
            raise ProgramError(f"program {name} composes nothing")
        self._notes["subtasks"] = list(found)
        return found

    def _rehearse(self) -> None:
        """Every program once on the first look, without moving: what is wrong is found, and what has to be asked is
        asked, before the robot is near anybody and while the first call's long deadline holds."""
        for subtask in self._waiting:
            self._rehearse_one(subtask)

    def _rehearse_one(self, subtask: str) -> None:
        moves = 0

        def execute(*args: object, **kwargs: object) -> None:
            nonlocal moves
            moves += 1
            try:
                execution = self._execution(args, kwargs)
            except ProgramError as error:
                # The program's own mistake: told with its name and line, as those of every other call are.
                raise ValueError(str(error)) from None
            self._try(execution)

        def reset_to_default_pose() -> None:
            nonlocal moves
            moves += 1

        name = f"composer: {subtask}"
        moving: Functions = {"execute": execute, "reset_to_default_pose": reset_to_default_pose}
        self._box.run(name, self._program("composer", subtask), {**self._composer_functions(), **moving})
        if not moves:
            raise ProgramError(f"program {name} moves nothing: it calls neither {' nor '.join(MOVES)}")

    def _try(self, execution: Execution) -> None:
        for query in execution.maps.values():
            self._composed(query)

    def _next_actions(self) -> Sequence[Action]:
        while True:
            if self._current is None and not self._advance():
                return [Action(done=True)]
            assert self._current is not None
            moved = self._move(self._current)
            if moved is not None:
                self._current.whole = moved.whole
                return moved.actions
            self._current = None

    def _advance(self) -> bool:
        """To the next call that moves the robot; False when there is none."""
        if self._running is not None:
            self._running.resume()
        while self._running is None or self._running.pause is None:
            if not self._waiting:
                return False
            self._subtask = self._waiting.pop(0)
            # Their bodies are never run: the program waits there.
            functions = self._composer_functions() | dict.fromkeys(MOVES, _unreachable)
            code = self._program("composer", self._subtask)
            self._running = self._box.started(f"composer: {self._subtask}", code, functions, pause_at=MOVES)
        pause = self._running.pause
        home = pause.function == "reset_to_default_pose"
        self._current = Execution(maps={}, home=True) if home else self._execution(pause.args, pause.kwargs)
        return True

    def _move(self, current: Execution) -> Motion | None:
        """The next stretch; None when the motion is over."""
        assert self._grid is not None
        grid, tool = self._grid, self._scene.pose_tcp
        if current.home:
            return None if current.whole else self._homewards(grid)
        if current.plans >= fixed.MAX_PLANS:
            return None
        maps: dict[MapKind, ValueMap] = {kind: self._composed(query) for kind, query in current.maps.items()}
        target = self._target(maps.get("affordance"))
        avoidance = maps.get("avoidance", ValueMap(kind="avoidance")).dense(grid)
        made = plan(grid.voxel(tool[:3]), target, avoidance, self._scene.occupied())
        if current.whole and made.distance[grid.voxel(tool[:3])] <= fixed.REACHED_VOXELS:
            return None
        waypoints = grid.points(made.waypoints)
        current.plans += 1
        self._note_plan(current, made, target, waypoints, maps)
        return motion(
            forward_only(waypoints, tool[:3]), tool, grid=grid, velocity=maps.get("velocity"),
            rotation=maps.get("rotation"), gripper=maps.get("gripper"),
            horizon_s=self.horizon_s, settle_s=self.settle_s,
        )  # fmt: skip

    def _homewards(self, grid: Grid) -> Motion:
        assert self._home is not None
        turn = ValueMap(kind="rotation")
        turn.add(grid.voxel(self._home[:3]), tuple(self._home[3:].tolist()), radius_cm=fixed.RADIUS_LIMIT_CM)
        return motion(
            np.clip(self._home[None, :3], grid.low_m, grid.high_m), self._scene.pose_tcp, grid=grid, velocity=None,
            rotation=turn, gripper=None, horizon_s=fixed.HOME_LIMIT_S, settle_s=self.settle_s,
        )  # fmt: skip

    def _target(self, affordance: ValueMap | None) -> npt.NDArray[np.float32]:
        """Without a map the tool stays: a call may only turn it."""
        assert self._grid is not None
        stay = ValueMap(kind="affordance")
        stay.add(self._grid.voxel(self._scene.pose_tcp[:3]), (1.0,))
        dense = (affordance or stay).dense(self._grid)
        if not len(goals(dense)):
            raise ProgramError(f"no voxel of the affordance map of {self._subtask!r} is 1: there is nowhere to go")
        return dense

    def _execution(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Execution:
        """Raises ProgramError for what ``execute`` cannot be given."""
        given = self._given(args, kwargs)
        movable = given["movable"]
        if not isinstance(movable, PartHandle) or movable.name != GRIPPER:
            raise ProgramError(f"execute: only the {GRIPPER} moves by itself, not {told(movable)}")
        maps: dict[MapKind, MapQuery] = {}
        for name, query in given.items():
            if name not in _MAPS or query is None:
                continue
            if not isinstance(query, MapQuery) or query.kind != _MAPS[name]:
                raise ProgramError(f"execute: {name} expects what get_{name} returns, or None; got {told(query)}")
            maps[_MAPS[name]] = query
        return Execution(maps=maps)

    def _given(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
        """By name, in the order of the call: maps that are asked for first are in the recording first."""
        try:
            named = bound("execute", self.execute, args, kwargs).arguments
        except TypeError as error:
            raise ProgramError(f"execute: {error}") from None
        order = [name for name in named if name not in kwargs] + list(kwargs)
        return {name: named[name] for name in order}

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        def ask_for(kind: MapKind) -> Callable[..., object]:
            def asked(query: object) -> object:
                return ClassInstance(MapQuery(kind, text_of(query)))

            return asked

        return {f"get_{kind}_map": ask_for(kind) for kind in KINDS} | {"parse_query_obj": self._parsed}

    def _composed(self, query: MapQuery) -> ValueMap:
        role = f"get_{query.kind}_map"
        code = self._program(role, query.query)
        made = self._box.value(f"{role}: {query.query}", code, self._map_functions())
        if not isinstance(made, ValueMap) or made.kind != query.kind:
            raise ProgramError(f"program {role}: {query.query} leaves no {query.kind} map in ret_val")
        return made

    def _map_functions(self) -> Functions:
        return self._functions.table() | {"parse_query_obj": self._parsed}

    def _parsed(self, query: object) -> object:
        text = text_of(query)
        code = self._program("parse_query_obj", text)
        found = self._box.value(f"parse_query_obj: {text}", code, self._functions.table())
        if isinstance(found, list):
            parts = [offered(part) for part in cast("list[object]", found) if isinstance(part, PartHandle)]
            if parts and len(parts) == len(cast("list[object]", found)):
                return parts
        if not isinstance(found, PartHandle):
            raise ProgramError(f"program parse_query_obj: {text} leaves no part in ret_val, nor a list of parts")
        return offered(found)

    def _program(self, role: str, query: str) -> str:
        with self._box.time.not_counted():
            return self._programs.program(role, query)

    def _note_plan(
        self,
        current: Execution,
        made: Plan,
        target: npt.NDArray[np.float32],
        waypoints: F64,
        maps: dict[MapKind, ValueMap],
    ) -> None:
        assert self._grid is not None
        view, grid, tool = self._scene.view, self._grid, self._scene.pose_tcp[:3]
        targets = goals(target)
        goal = targets.mean(axis=0)
        path = np.vstack([tool, waypoints])
        self._notes |= {
            "subtask": self._subtask, "plan": current.plans, "path_m": path.round(4).tolist(),
            "path_px": pixels(path, view.intrinsics, view.pose_camera_in_base).round(1).tolist(),
            "target_m": grid.points(goal).round(4).tolist(),
        }  # fmt: skip
        if current.plans > 1:
            return
        way = [
            manner(
                grid, place, velocity=maps.get("velocity"), rotation=maps.get("rotation"), gripper=maps.get("gripper")
            )
            for place in waypoints
        ]
        _, y, z = np.rint(goal).astype(int).tolist()
        self._notes |= {
            "grid": {"low_m": grid.low_m.tolist(), "high_m": grid.high_m.tolist(), "level": z, "upright": y},
            "intrinsics": view.intrinsics.tolist(), "pose_camera_in_base": view.pose_camera_in_base.tolist(),
            "maps": {kind: query.query for kind, query in current.maps.items()},
            "written": {kind: value_map.rows()[:NOTED_ROWS] for kind, value_map in maps.items()},
            "target_voxels": targets[:NOTED_ROWS].tolist(),
            "path_speed_m_s": [said.speed_m_s for said in way], "path_quat": [said.quat for said in way],
            "path_gripper": [said.gripper for said in way],
            "cost_level": made.cost[:, :, z].astype(np.float16), "cost_upright": made.cost[:, y, :].astype(np.float16),
            "distance_level": made.distance[:, :, z].astype(np.float16),
            "avoidance_level": made.avoidance[:, :, z].astype(np.float16),
        }  # fmt: skip

    @property
    def _box(self) -> Sandbox:
        assert self._sandbox is not None
        return self._sandbox


def text_of(query: object) -> str:
    if not isinstance(query, str) or not query.strip() or len(query) > fixed.MAX_QUERY:
        shown = repr(query[:80]) if isinstance(query, str) else f"{query!r:.80}"
        raise ValueError(f"expected a text of 1 to {fixed.MAX_QUERY} characters, got {shown}")
    return query


def _unreachable(*args: object, **kwargs: object) -> None:
    raise AssertionError("a program went on at a call where it should have waited")


def _transcript(language: str, record: Path | None) -> Transcript:
    transcript = transcript_of(language, record=record)
    if transcript is None:
        raise ConfigError("voxposer needs programs: --language replay:FILE.jsonl or live:MODEL, not rules-v1")
    return transcript
