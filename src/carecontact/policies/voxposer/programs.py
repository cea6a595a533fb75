"""The language-model programs: prompts, the roles that call one another, and the parameters of a motion that they
yield."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter, Signature
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.errors import LanguageError, ProgramError
from carecontact.policies.language.completion import Message, Transcript, unfenced
from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import KINDS, MapKind, ValueMap
from carecontact.policies.voxposer.sandbox import Functions, Pause, PausedProgram, Sandbox, bound
from carecontact.policies.voxposer.scene import GRIPPER, NAMES, MapFunctions, PartHandle, described, offered, text_of

# Our own prompts: what each role is, what it may call, and examples that are not among the benchmark's tasks.

_SETTING = f"""\
You write short Python programs for a robot arm that cares for a person lying face up on a bed beside it. Space is a
grid of 100 x 100 x 100 voxels over the workspace in the robot's frame: x grows away from the robot's base, y to its
left, z upwards. Positions are tuples (x, y, z) of whole voxels; a voxel is about 1 cm wide. Known names:
{", ".join(NAMES)}. Nothing measures force. Answer with the program alone. No imports are needed, none are there beside
math; variables are not kept between programs.
"""
_PARTS = """\
parse_query_obj(text) returns a part of the scene with .name, .position (mean of its visible points), .low and .high
(corners of the box round them) and .normal (unit vector out of its surface). cm2index(cm, "x"|"y"|"z") gives
centimetres in voxels along an axis, cm2index(cm, vector) gives a step (dx, dy, dz) of that length along a vector.
"""
_WRITE = """\
set_voxel(map, (x, y, z), value) writes one voxel; set_voxel_by_radius(map, (x, y, z), radius_cm, value) writes a box of
that half width.
Leave the map in ret_val.
"""

PLANNER = """\
Your role: planner. Divide the instruction into motions of the arm, each one call composer("...") with everything the
motion needs to know in its words. End with composer("back to default pose").

instruction: rest your hand on the left elbow
composer("move slowly onto the left elbow")
composer("back to default pose")

instruction: stroke the left upper arm downwards
composer("move slowly onto the shoulder end of the left upper arm")
composer("move slowly along the left upper arm to its elbow end")
composer("back to default pose")
"""
COMPOSER = """\
Your role: composer. Turn one motion into maps and carry it out. parse_query_obj(text) names what moves, which is always
the gripper. get_affordance_map(text): where to go. get_avoidance_map(text): what to keep away from.
get_rotation_map(text): how to hold the tool. get_velocity_map(text): how fast, 1 is full speed. get_gripper_map(text):
1 open, 0 closed.
execute(movable, affordance_map=..., avoidance_map=..., rotation_map=..., velocity_map=..., gripper_map=...) moves; only
the affordance map is always needed. reset_to_default_pose() goes back to where the arm began.

motion: move slowly onto the left elbow
movable = parse_query_obj("gripper")
affordance_map = get_affordance_map("a point at the center of the left elbow")
rotation_map = get_rotation_map("pointing down")
velocity_map = get_velocity_map("a quarter of full speed within 10cm of the left elbow")
execute(movable, affordance_map=affordance_map, rotation_map=rotation_map, velocity_map=velocity_map)

motion: move to 20cm above the left hip and stay 15cm away from the left wrist
movable = parse_query_obj("gripper")
affordance_map = get_affordance_map("a point 20cm above the left hip")
avoidance_map = get_avoidance_map("15cm around the left wrist")
execute(movable, affordance_map=affordance_map, avoidance_map=avoidance_map)

motion: back to default pose
reset_to_default_pose()
"""
PARSE = """\
Your role: parse_query_obj. detect(name) finds one of the known names. Leave the part that is meant in ret_val.

query: the higher one of left wrist and left hip
wrist, hip = detect("left wrist"), detect("left hip")
ret_val = wrist if wrist.position[2] >= hip.position[2] else hip

query: gripper
ret_val = detect("gripper")
"""
AFFORDANCE = """\
Your role: get_affordance_map. Write 1 into the voxels to go to; everything else is 0. get_empty_affordance_map() makes
the map.

query: a point 20cm above the left hip
affordance_map = get_empty_affordance_map()
x, y, z = parse_query_obj("left hip").position
set_voxel(affordance_map, (x, y, z + cm2index(20, "z")), 1)
ret_val = affordance_map

query: a point halfway between left wrist and left elbow
affordance_map = get_empty_affordance_map()
a, b = parse_query_obj("left wrist").position, parse_query_obj("left elbow").position
set_voxel(affordance_map, tuple((p + q) // 2 for p, q in zip(a, b)), 1)
ret_val = affordance_map
"""
AVOIDANCE = """\
Your role: get_avoidance_map. Write 1 into the voxels to keep away from; everything else is 0.
get_empty_avoidance_map() makes the map. Visible surfaces are avoided anyway.

query: 15cm around the left wrist
avoidance_map = get_empty_avoidance_map()
set_voxel_by_radius(avoidance_map, parse_query_obj("left wrist").position, radius_cm=15, value=1)
ret_val = avoidance_map
"""
ROTATION = """\
Your role: get_rotation_map. Write quaternions (w, x, y, z) of the tool; everywhere else it keeps the turn it has.
vec2quat(vector) gives the one whose tool points along a vector. get_empty_rotation_map() makes the map.

query: pointing at the left hip from the side within 20cm of it
rotation_map = get_empty_rotation_map()
hip = parse_query_obj("left hip")
set_voxel_by_radius(rotation_map, hip.position, radius_cm=20, value=vec2quat((1, 0, -1)))
ret_val = rotation_map

query: pointing down
rotation_map = get_empty_rotation_map()
set_voxel_by_radius(rotation_map, (50, 50, 50), radius_cm=200, value=vec2quat((0, 0, -1)))
ret_val = rotation_map
"""
VELOCITY = """\
Your role: get_velocity_map. Write factors of full speed, more than 0 and at most 1; everywhere else it is 1.
get_empty_velocity_map() makes the map.

query: a quarter of full speed within 10cm of the left elbow
velocity_map = get_empty_velocity_map()
set_voxel_by_radius(velocity_map, parse_query_obj("left elbow").position, radius_cm=10, value=0.25)
ret_val = velocity_map
"""
GRIPPER_MAP = """\
Your role: get_gripper_map. Write 1 where the gripper is to be open and 0 where it is to be closed.
get_empty_gripper_map() makes the map.

query: closed everywhere
gripper_map = get_empty_gripper_map()
set_voxel_by_radius(gripper_map, (50, 50, 50), radius_cm=200, value=0)
ret_val = gripper_map
"""


@dataclass(frozen=True, kw_only=True)
class PromptSet:
    """The prompts of one method."""

    version: str
    """Changes with any word of a prompt, because recorded completions answer one version only."""
    roles: Mapping[str, str]
    """Role -> system message."""

    def system(self, role: str) -> str:
        """Return the system message of a role."""
        return self.roles[role]

    def user(self, query: str) -> str:
        """Return the user message of a query."""
        return query


def _map_role(text: str) -> str:
    return _SETTING + _PARTS + _WRITE + text


VOXPOSER = PromptSet(
    version="voxposer-v2",
    roles={
        "planner": _SETTING + PLANNER,
        "composer": _SETTING + COMPOSER,
        "parse_query_obj": _SETTING + PARSE,
        "get_affordance_map": _map_role(AFFORDANCE),
        "get_avoidance_map": _map_role(AVOIDANCE),
        "get_rotation_map": _map_role(ROTATION),
        "get_velocity_map": _map_role(VELOCITY),
        "get_gripper_map": _map_role(GRIPPER_MAP),
    },
)

PHASED_PLANNER = (
    PLANNER
    + """
instruction: rub the left upper arm
composer("move slowly onto the center of the left upper arm and slide 15cm back and forth along it")
composer("back to default pose")
"""
)
PHASED_COMPOSER = (
    COMPOSER
    + """
get_progress(text) says what is to be achieved once the tool touches. execute(..., progress=...) follows the maps until
then and the objective alone afterwards, until it is met.

motion: move slowly onto the center of the left upper arm and slide 15cm back and forth along it
movable = parse_query_obj("gripper")
affordance_map = get_affordance_map("a point at the center of the left upper arm")
rotation_map = get_rotation_map("pointing down")
progress = get_progress("slide 15cm back and forth along the left upper arm")
execute(movable, affordance_map=affordance_map, rotation_map=rotation_map, progress=progress)
"""
)
PROGRESS = """\
Your role: get_progress. Leave in ret_val one objective. slide(direction, distance_cm, span_cm): rub back and forth
along a vector, span_cm from end to end, until the tool has gone distance_cm in all. displace(direction, distance_cm):
push along a vector until the tool has moved distance_cm since it touched, and hold.

query: slide 15cm back and forth along the left upper arm
a, b = parse_query_obj("left shoulder").position, parse_query_obj("left elbow").position
ret_val = slide((b[0] - a[0], b[1] - a[1], b[2] - a[2]), distance_cm=15, span_cm=8)
"""
VOXPOSER_PHASED = PromptSet(
    version="voxposer-phased-v2",
    roles={
        **VOXPOSER.roles,
        "planner": _SETTING + PHASED_PLANNER,
        "composer": _SETTING + PHASED_COMPOSER,
        "get_progress": _SETTING + _PARTS + PROGRESS,
    },
)

SETS: Mapping[str, PromptSet] = {"authored": VOXPOSER, "authored-phased": VOXPOSER_PHASED}
"""Name of a file of completions that were written by hand -> the prompts that they answer."""


# Asks a language model for the program that answers a query.


class Programs:
    """Requests programs on demand; the same query is never sent twice."""

    def __init__(self, transcript: Transcript, prompts: PromptSet) -> None:
        self._transcript, self._prompts = transcript, prompts
        self._written: dict[tuple[str, str], str] = {}

    def program(self, role: str, query: str) -> str:
        """Return the program for a query to ``role``, which is one of the prompts.

        Raises LanguageError if the language model gives none.
        """
        key = (role, query)
        if key not in self._written:
            messages = [
                Message(role="system", content=self._prompts.system(role)),
                Message(role="user", content=self._prompts.user(query)),
            ]
            text = self._transcript.text(messages, purpose=f"{role}: {query}", prompt_version=self._prompts.version)
            self._written[key] = unfenced(text)
            if not self._written[key].strip():
                raise LanguageError(f"{self._transcript.name}: the answer to {role}: {query} contains no program")
        return self._written[key]

    def take_calls(self) -> list[dict[str, object]]:
        """Return the calls to the language model since the last time, for the recording."""
        return self._transcript.take_calls()

    @property
    def written(self) -> list[dict[str, str]]:
        """Every program with its role and query, in the order in which they were requested."""
        return [{"role": role, "query": query, "code": code} for (role, query), code in self._written.items()]


# One call of ``execute`` in a program: which maps it may be given, and how far the robot has carried it out.

_MAPS: dict[str, MapKind] = {f"{kind}_map": kind for kind in KINDS}
EXECUTE = Signature(
    [Parameter("movable", Parameter.POSITIONAL_OR_KEYWORD)]
    + [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None) for name in _MAPS]
)
"""How a program calls ``execute``: in the release's order, with None for what is not given."""


@dataclass(frozen=True)
class MapQuery:
    """A map as a program holds it: a description of what the map shall be. It is composed anew for every plan."""

    kind: MapKind
    query: str

    @property
    def description(self) -> str:
        return f"{self.kind} map"


@dataclass(kw_only=True)
class Execution:
    """One call of ``execute`` or ``reset_to_default_pose`` that the robot is carrying out."""

    maps: dict[MapKind, MapQuery]
    home: npt.NDArray[np.float64] | None = None
    """(7,) pose to return to in base, for ``reset_to_default_pose``; None: follow the maps."""
    plans: int = 0
    whole: bool = False
    """Whether the last motion went to the end of its path."""


def arguments(signature: Signature, args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a call of ``execute`` by name, in the order of the call.

    The recording lists maps in this order, because they are composed in it. Raises ProgramError for a call that
    ``signature`` does not allow.
    """
    try:
        named = bound("execute", signature, args, kwargs).arguments
    except TypeError as error:
        raise ProgramError(f"execute: {error}") from None
    order = [name for name in named if name not in kwargs] + list(kwargs)
    return {name: named[name] for name in order}


def map_queries(given: dict[str, Any]) -> dict[MapKind, MapQuery]:
    """Return the maps among the arguments of ``execute``.

    Raises ProgramError if something other than the gripper is to move, or a map is not of the kind that its name says.
    """
    movable = given["movable"]
    if not isinstance(movable, PartHandle) or movable.name != GRIPPER:
        raise ProgramError(f"execute: only the {GRIPPER} moves by itself, not {described(movable)}")
    maps: dict[MapKind, MapQuery] = {}
    for name, query in given.items():
        if name not in _MAPS or query is None:
            continue
        if not isinstance(query, MapQuery) or query.kind != _MAPS[name]:
            raise ProgramError(f"execute: {name} expects what get_{name} returns, or None; got {described(query)}")
        maps[_MAPS[name]] = query
    return maps


# The roles that a language model writes programs for: each program runs in the sandbox and its result is checked.


class Roles:
    """Answers the queries of one trial. Every method raises ProgramError or LanguageError."""

    def __init__(self, programs: Programs, sandbox: Sandbox, functions: MapFunctions) -> None:
        self._programs, self._sandbox, self._functions = programs, sandbox, functions

    def code(self, role: str, query: str) -> str:
        """Return the program that answers a query. The language model's time does not count as the program's."""
        with self._sandbox.time.not_counted():
            return self._programs.program(role, query)

    def result(self, role: str, query: str, functions: Functions) -> object:
        """Run the program that answers a query, and return what it leaves in ``ret_val``."""
        return self._sandbox.value(f"{role}: {query}", self.code(role, query), functions)

    def subtasks(self, instruction: str) -> list[str]:
        """Return the motions into which the planner divides the instruction, at least one."""
        found: list[str] = []

        def composer(query: object) -> None:
            if len(found) >= fixed.MAX_SUBTASKS:
                raise ValueError(f"composer: expected at most {fixed.MAX_SUBTASKS} texts")
            found.append(text_of(query))

        name = f"planner: {instruction}"
        self._sandbox.run(name, self.code("planner", instruction), {"composer": composer})
        if not found:
            raise ProgramError(f"program {name} composes nothing")
        return found

    def value_map(self, query: MapQuery) -> ValueMap:
        """Compose a map from the latest look."""
        role = f"get_{query.kind}_map"
        made = self.result(role, query.query, self.map_functions())
        if not isinstance(made, ValueMap) or made.kind != query.kind:
            raise ProgramError(f"program {role}: {query.query} leaves no {query.kind} map in ret_val")
        return made

    def composer_functions(self) -> dict[str, Callable[..., object]]:
        """Return what a composer may call, apart from the calls that move the robot."""

        def ask_for(kind: MapKind) -> Callable[..., object]:
            def asked(query: object) -> object:
                return ClassInstance(MapQuery(kind, text_of(query)))

            return asked

        return {f"get_{kind}_map": ask_for(kind) for kind in KINDS} | {"parse_query_obj": self._part}

    def map_functions(self) -> Functions:
        """Return what a program that composes a map may call."""
        return self._functions.table() | {"parse_query_obj": self._part}

    def _part(self, query: object) -> object:
        text = text_of(query)
        found = self.result("parse_query_obj", text, self._functions.table())
        if isinstance(found, list):
            parts = [offered(part) for part in cast("list[object]", found) if isinstance(part, PartHandle)]
            if parts and len(parts) == len(cast("list[object]", found)):
                return parts
        if not isinstance(found, PartHandle):
            raise ProgramError(f"program parse_query_obj: {text} leaves no part in ret_val, nor a list of parts")
        return offered(found)


# The composer programs of all subtasks: rehearsed once without moving, then run one after another with the robot.

HOME = "reset_to_default_pose"
MOVES = ("execute", HOME)
"""Calls at which a program waits for the robot."""


class Composers:
    """Runs the composers in order and pauses each wherever it moves the robot."""

    def __init__(self, sandbox: Sandbox, roles: Roles, subtasks: Sequence[str], functions: Functions) -> None:
        """``functions``: what a composer may call, apart from MOVES."""
        self._sandbox, self._roles, self._functions = sandbox, roles, functions
        self._waiting = list(subtasks)
        self._running: PausedProgram | None = None
        self.subtask = ""
        """The subtask whose composer runs."""

    def rehearse(self, try_execute: Callable[[tuple[Any, ...], dict[str, Any]], None]) -> None:
        """Run every program once on the first look, without moving.

        What is wrong is found, and what a language model has to be asked is asked, before the robot is near anybody
        and while the long deadline of the first call holds.

        Args:
            try_execute: checks the positional and keyword arguments of a call of ``execute``, and composes its maps.

        Raises:
            ProgramError: a program is stopped, is wrong, or moves nothing.
        """
        for subtask in self._waiting:
            self._rehearse_one(subtask, try_execute)

    def next_move(self) -> Pause | None:
        """Run on to the next call that moves the robot, and return it; None once every program has ended."""
        if self._running is not None:
            self._running.resume()
        while self._running is None or self._running.pause is None:
            if not self._waiting:
                return None
            self.subtask = self._waiting.pop(0)
            # The bodies of these functions never run: the program waits at the call.
            functions = {**self._functions, **dict.fromkeys(MOVES, _unreachable)}
            code = self._roles.code("composer", self.subtask)
            self._running = self._sandbox.started(f"composer: {self.subtask}", code, functions, pause_at=MOVES)
        return self._running.pause

    def _rehearse_one(self, subtask: str, try_execute: Callable[[tuple[Any, ...], dict[str, Any]], None]) -> None:
        moves = 0

        def execute(*args: object, **kwargs: object) -> None:
            nonlocal moves
            moves += 1
            try_execute(args, kwargs)

        def reset_to_default_pose() -> None:
            nonlocal moves
            moves += 1

        name = f"composer: {subtask}"
        moving: Functions = {"execute": execute, HOME: reset_to_default_pose}
        self._sandbox.run(name, self._roles.code("composer", subtask), {**self._functions, **moving})
        if not moves:
            raise ProgramError(f"program {name} moves nothing: it calls neither {' nor '.join(MOVES)}")


def _unreachable(*args: object, **kwargs: object) -> None:
    raise AssertionError("a program went on at a call where it should have waited")
