"""The language-model programs: prompts, the roles that call one another, and the parameters of a motion that they
yield."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from inspect import Parameter, Signature
from typing import Any, cast

from pydantic_monty import ClassInstance, FunctionSnapshot

from carecontact.errors import LanguageError, ProgramError
from carecontact.policies.language.completion import Message, Transcript, unfenced
from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import KINDS, MapKind, ValueMap
from carecontact.policies.voxposer.sandbox import Functions, Sandbox, bound
from carecontact.policies.voxposer.scene import GRIPPER, NAMES, MapFunctions, PartHandle, described, offered, text_of


@dataclass(frozen=True, kw_only=True)
class PromptSet:
    """The prompts of one method; the user's message is the query itself."""

    version: str
    """Changes with any word of a prompt, because recorded completions answer one version only."""
    roles: Mapping[str, str]
    """Role -> system message."""


_TEXTS = tomllib.loads((resources.files(__package__ or __name__) / "prompts.toml").read_text(encoding="utf-8"))
_SETTING = _TEXTS["setting"].replace("{names}", ", ".join(NAMES))
_PARTS = _SETTING + _TEXTS["parts"]
VOXPOSER = PromptSet(
    version="voxposer-v3",
    roles={role: _SETTING + _TEXTS[role] for role in ("planner", "composer", "parse_query_obj")}
    | {f"get_{kind}_map": _PARTS + _TEXTS["write"] + _TEXTS[f"get_{kind}_map"] for kind in KINDS},
)
VOXPOSER_PHASED = PromptSet(
    version="voxposer-phased-v3",
    roles={
        **VOXPOSER.roles,
        "planner": VOXPOSER.roles["planner"] + _TEXTS["planner_phased"],
        "composer": VOXPOSER.roles["composer"] + _TEXTS["composer_phased"],
        "get_progress": _PARTS + _TEXTS["get_progress"],
    },
)
SETS: Mapping[str, PromptSet] = {"authored": VOXPOSER, "authored-phased": VOXPOSER_PHASED}
"""Name of a file of completions that were written by hand -> the prompts that they answer."""


class Programs:
    """Requests programs on demand; the same query is never sent twice."""

    def __init__(self, transcript: Transcript, prompts: PromptSet) -> None:
        self._transcript, self._prompts = transcript, prompts
        self._written: dict[tuple[str, str], str] = {}

    def program(self, role: str, query: str) -> str:
        """Return the program for a query to a role. Raises LanguageError if the language model gives none."""
        key = (role, query)
        if key not in self._written:
            name, prompts = f"{role}: {query}", self._prompts
            messages = [Message(role="system", content=prompts.roles[role]), Message(role="user", content=query)]
            text = self._transcript.text(messages, purpose=name, prompt_version=prompts.version)
            self._written[key] = unfenced(text)
            if not self._written[key].strip():
                raise LanguageError(f"{self._transcript.name}: the answer to {name} contains no program")
        return self._written[key]

    def take_calls(self) -> list[dict[str, object]]:
        return self._transcript.take_calls()

    @property
    def written(self) -> list[dict[str, str]]:
        """Every program with its role and query, in the order in which they were requested."""
        return [{"role": role, "query": query, "code": code} for (role, query), code in self._written.items()]


_MAPS: dict[str, MapKind] = {f"{kind}_map": kind for kind in KINDS}
EXECUTE = Signature(
    [Parameter("movable", Parameter.POSITIONAL_OR_KEYWORD)]
    + [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None) for name in _MAPS]
)
"""How a program calls ``execute``: in the release's order, with None for what is not given."""


@dataclass(frozen=True)
class MapQuery:
    """A map as a program holds it: a description of what the map shall be. It is composed again for every plan."""

    kind: MapKind
    query: str

    @property
    def description(self) -> str:
        return f"{self.kind} map"


def arguments(signature: Signature, args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a call of ``execute`` by name, in the order of the call, in which maps are composed.

    Raises ProgramError for a call that ``signature`` does not allow.
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


class Roles:
    """Answers the queries of a trial by programs in the sandbox. Every method raises ProgramError or LanguageError."""

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
        role = f"get_{query.kind}_map"
        made = self.result(role, query.query, self.map_functions())
        if not isinstance(made, ValueMap) or made.kind != query.kind:
            raise ProgramError(f"program {role}: {query.query} leaves no {query.kind} map in ret_val")
        return made

    def composer_functions(self) -> dict[str, Callable[..., object]]:
        """Return what a composer may call, apart from MOVES."""

        def get_map(kind: MapKind, query: object) -> object:
            return ClassInstance(MapQuery(kind, text_of(query)))

        return {f"get_{kind}_map": partial(get_map, kind) for kind in KINDS} | {"parse_query_obj": self._part}

    def map_functions(self) -> Functions:
        return self._functions.table() | {"parse_query_obj": self._part}

    def _part(self, query: object) -> object:
        text = text_of(query)
        found = self.result("parse_query_obj", text, self._functions.table())
        listed = cast("list[object]", found if isinstance(found, list) else [found])
        parts = [offered(part) for part in listed if isinstance(part, PartHandle)]
        if not parts or len(parts) < len(listed):
            raise ProgramError(f"program parse_query_obj: {text} leaves no part in ret_val, nor a list of parts")
        return parts if isinstance(found, list) else parts[0]


HOME = "reset_to_default_pose"
MOVES = ("execute", HOME)
"""Calls at which a program waits for the robot."""


class Composers:
    """Rehearses the composer programs of all subtasks, then runs each with pauses wherever it moves the robot."""

    def __init__(self, sandbox: Sandbox, roles: Roles, subtasks: Sequence[str], functions: Functions) -> None:
        """``functions``: what a composer may call, apart from MOVES."""
        self._sandbox, self._roles, self._functions, self._subtasks = sandbox, roles, functions, subtasks
        self.moves = self._moves()
        """The calls that move the robot; each program waits until the next one is requested."""
        self.subtask = ""
        """The subtask whose composer runs."""

    def rehearse(self, try_execute: Callable[[tuple[Any, ...], dict[str, Any]], None]) -> None:
        """Run every program once on the first look, without moving: ``try_execute`` stands for ``execute``.

        Faults are found, and all requests to a language model are made, before the robot is near a person and while
        the long deadline of the first call holds. Raises ProgramError also for a program that moves nothing.
        """
        moves: list[str] = []

        def execute(*args: object, **kwargs: object) -> None:
            moves.append("execute")
            try_execute(args, kwargs)

        def reset_to_default_pose() -> None:
            moves.append(HOME)

        functions = {**self._functions, "execute": execute, HOME: reset_to_default_pose}
        for subtask in self._subtasks:
            moves.clear()
            name = f"composer: {subtask}"
            self._sandbox.run(name, self._roles.code("composer", subtask), functions)
            if not moves:
                raise ProgramError(f"program {name} moves nothing: it calls neither {' nor '.join(MOVES)}")

    def _moves(self) -> Iterator[FunctionSnapshot]:
        # The bodies of these functions never run: the program waits at the call.
        functions = {**self._functions, **dict.fromkeys(MOVES, _unreachable)}
        for subtask in self._subtasks:
            self.subtask, code = subtask, self._roles.code("composer", subtask)
            yield from self._sandbox.calls(f"composer: {subtask}", code, functions, pause_at=MOVES)


def _unreachable(*args: object, **kwargs: object) -> None:
    raise AssertionError("a program went on at a call where it should have waited")
