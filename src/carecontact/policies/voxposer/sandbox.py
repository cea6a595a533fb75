"""Runs programs that a language model wrote: in another process and interpreter, with limits on everything."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from pydantic_monty import (
    CollectString,
    FunctionSnapshot,
    Monty,
    MontyComplete,
    MontySession,
    OSPolicy,
    ResourceLimits,
)

from carecontact.errors import ProgramError
from carecontact.policies.voxposer.host_functions import MAX_CALLS, Functions, HostFunctions
from carecontact.policies.voxposer.program_time import ProgramTime

LIMITS = ResourceLimits(
    max_feed_duration_secs=2.0, max_memory=64 << 20, max_recursion_depth=200, max_suspensions=MAX_CALLS
)
"""Limits of one program. Programs need milliseconds and kilobytes, because their calls do the work here."""
STEP_S = 10.0
"""Limit of all programs of one step together, including those that programs call: a third of the shortest deadline of
a call in bathing-v3-draft."""
REQUEST_S = 10.0
"""A worker that does not answer for this long is killed."""
PRINTED_BYTES = 65536
MAX_PROGRAM_CHARS = 20_000
OS_POLICY = OSPolicy(datetime=datetime.datetime(2000, 1, 1), sleep="zero", random_start={"seed": 0})
"""No clock, no waiting and no random numbers: the same program does the same thing each time."""
RESULT = "ret_val"


@dataclass(frozen=True, kw_only=True)
class Pause:
    """A call at which a program waits for its answer."""

    function: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    snapshot: FunctionSnapshot


class Sandbox:
    """A pool of interpreters without files, network, or any module of Python's but harmless ones.

    A program sees objects of ours as handles with the attributes that are offered, and hands them back as themselves.
    Every method that runs a program raises ProgramError, which names the program, what it did and in which line. An
    error of carecontact that a called function raises comes out as it is.
    """

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._pool = self._stack.enter_context(Monty(max_processes=3, request_timeout=REQUEST_S))
        self.time = ProgramTime(STEP_S)

    def close(self) -> None:
        """End the interpreters' processes."""
        self._stack.close()

    def value(self, name: str, code: str, functions: Functions) -> object:
        """Run the program called ``name``, and return what it leaves in ``ret_val``."""
        self.time.check(name)
        code, host = _checked(name, code), HostFunctions(name, functions, self.time)
        shortest = min(LIMITS.get("max_feed_duration_secs") or STEP_S, self.time.left_s)
        limits: ResourceLimits = {**LIMITS, "max_feed_duration_secs": shortest}
        with self.time.running(), host.errors_of(name), self._session(limits) as session:
            return session.feed_run(
                f"{code}\n{RESULT}", external_lookup=host.table, print_callback=CollectString(PRINTED_BYTES)
            )

    def run(self, name: str, code: str, functions: Functions) -> None:
        """Run the program called ``name`` for the functions that it calls."""
        self.value(name, f"{code}\n{RESULT} = None", functions)

    def started(self, name: str, code: str, functions: Functions, *, pause_at: Collection[str]) -> PausedProgram:
        """Run the program up to its first call of one of ``pause_at``, which are names in ``functions``."""
        self.time.check(name)
        host = HostFunctions(name, functions, self.time)
        return PausedProgram(self._session(LIMITS), name, _checked(name, code), host, pause_at)

    def _session(self, limits: ResourceLimits) -> MontySession:
        return self._pool.checkout(limits=limits, os_policy=OS_POLICY)


class PausedProgram:
    """A program that waits while the robot carries out one of its calls."""

    def __init__(
        self, session: MontySession, name: str, code: str, host: HostFunctions, pause_at: Collection[str]
    ) -> None:
        self._name, self._pause_at, self._host = name, pause_at, host
        self._stack = ExitStack()
        self.pause: Pause | None = None
        """The call at which the program waits; None once it has ended."""
        self._go_on(
            lambda: self._stack.enter_context(session).feed_start(
                code, external_lookup=self._host.table, print_callback=CollectString(PRINTED_BYTES)
            )
        )

    def resume(self) -> None:
        """Run on to the next such call or to the end; the present call returns None."""
        assert self.pause is not None
        snapshot = self.pause.snapshot
        self._go_on(lambda: snapshot.resume({"return_value": None}))

    def close(self) -> None:
        """Drop the program."""
        self.pause = None
        self._stack.close()

    def _go_on(self, begin: Callable[[], object]) -> None:
        try:
            with self._host.time.running(), self._host.errors_of(self._name):
                self._to_the_next_pause(begin())
        except BaseException:
            self.close()
            raise

    def _to_the_next_pause(self, snapshot: Any) -> None:
        while not isinstance(snapshot, MontyComplete):
            if isinstance(snapshot, FunctionSnapshot) and snapshot.function_name in self._pause_at:
                self.pause = Pause(
                    function=snapshot.function_name, args=snapshot.args, kwargs=snapshot.kwargs, snapshot=snapshot
                )
                return
            snapshot = snapshot.resume_auto()
        self.close()


def _checked(name: str, code: str) -> str:
    if len(code) > MAX_PROGRAM_CHARS:
        raise ProgramError(f"program {name}: it has {len(code)} characters; at most {MAX_PROGRAM_CHARS} are run")
    return code
