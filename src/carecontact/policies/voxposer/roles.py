"""The roles that a language model writes programs for: each program runs in the sandbox and its result is checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from pydantic_monty import ClassInstance

from carecontact.errors import ProgramError
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.arguments import text_of
from carecontact.policies.voxposer.execution import MapQuery
from carecontact.policies.voxposer.functions import MapFunctions, PartHandle, offered
from carecontact.policies.voxposer.host_functions import Functions
from carecontact.policies.voxposer.lmp import Programs
from carecontact.policies.voxposer.maps import KINDS, MapKind, ValueMap
from carecontact.policies.voxposer.sandbox import Sandbox


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
