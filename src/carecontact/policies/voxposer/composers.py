"""The composer programs of all subtasks: rehearsed once without moving, then run one after another with the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from carecontact.errors import ProgramError
from carecontact.policies.voxposer.host_functions import Functions
from carecontact.policies.voxposer.roles import Roles
from carecontact.policies.voxposer.sandbox import Pause, PausedProgram, Sandbox

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
