"""Where programs run that a language model wrote: another process, another interpreter, limits on everything."""

from __future__ import annotations

import datetime
import inspect
from collections.abc import Callable, Collection, Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from pydantic_monty import (
    CollectString,
    FunctionSnapshot,
    Monty,
    MontyComplete,
    MontyCrashedError,
    MontyError,
    MontyRuntimeError,
    MontySession,
    MontySyntaxError,
    OSPolicy,
    ResourceLimits,
)

from carecontact.errors import CarecontactError, ProgramError
from carecontact.policies.voxposer.program_time import ProgramTime

MAX_CALLS = 2000
LIMITS = ResourceLimits(
    max_feed_duration_secs=2.0, max_memory=64 << 20, max_recursion_depth=200, max_suspensions=MAX_CALLS
)
"""Of one program. They take milliseconds and kilobytes; most of their calls are answered here."""
STEP_S = 10.0
"""For all programs of one step together, those that programs call included: a third of the shortest deadline of a call
in bathing-v1."""
REQUEST_S = 10.0
"""A worker that does not come back for so long is killed."""
PRINTED_BYTES = 65536
MAX_PROGRAM_CHARS = 20_000
OS_POLICY = OSPolicy(datetime=datetime.datetime(2000, 1, 1), sleep="zero", random_start={"seed": 0})
"""No clock, no waiting, no chance: the same program does the same thing each time."""
RESULT = "ret_val"

Functions = Mapping[str, Callable[..., object]]


@dataclass(frozen=True, kw_only=True)
class Pause:
    """A program that waits for an answer to a call."""

    function: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    snapshot: FunctionSnapshot


class Sandbox:
    """A pool of interpreters. No file, no network, no module of Python's but harmless ones, no attribute that is not
    offered; objects of ours appear as handles and come back as themselves.

    Every method raises ProgramError naming the program, what it did and in which line; errors of carecontact that one
    of its functions raised come out as they are.
    """

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._pool = self._stack.enter_context(Monty(max_processes=3, request_timeout=REQUEST_S))
        self.time = ProgramTime(STEP_S)

    def close(self) -> None:
        self._stack.close()

    def value(self, name: str, code: str, functions: Functions) -> object:
        """What the program leaves in ``ret_val``."""
        self.time.check(name)
        code, ours = _checked(name, code), _Ours(name, functions, self.time)
        shortest = min(LIMITS.get("max_feed_duration_secs") or STEP_S, self.time.left_s)
        limits: ResourceLimits = {**LIMITS, "max_feed_duration_secs": shortest}
        with self.time.running(), ours.errors_of(name), self._session(limits) as session:
            return session.feed_run(
                f"{code}\n{RESULT}", external_lookup=ours.table, print_callback=CollectString(PRINTED_BYTES)
            )

    def run(self, name: str, code: str, functions: Functions) -> None:
        """For what the program calls."""
        self.value(name, f"{code}\n{RESULT} = None", functions)

    def started(self, name: str, code: str, functions: Functions, *, pause_at: Collection[str]) -> PausedProgram:
        """The program, up to its first call of one of ``pause_at``, which are names in ``functions``."""
        self.time.check(name)
        ours = _Ours(name, functions, self.time)
        return PausedProgram(self._session(LIMITS), name, _checked(name, code), ours, pause_at)

    def _session(self, limits: ResourceLimits) -> MontySession:
        return self._pool.checkout(limits=limits, os_policy=OS_POLICY)


class PausedProgram:
    """A program between two calls that the robot carries out meanwhile."""

    def __init__(self, session: MontySession, name: str, code: str, ours: _Ours, pause_at: Collection[str]) -> None:
        self._name, self._pause_at, self._ours = name, pause_at, ours
        self._stack = ExitStack()
        self.pause: Pause | None = None
        """None: the program has ended."""
        self._go_on(
            lambda: self._stack.enter_context(session).feed_start(
                code, external_lookup=self._ours.table, print_callback=CollectString(PRINTED_BYTES)
            )
        )

    def resume(self) -> None:
        """To the next call or the end; the call that was paused at returns None."""
        assert self.pause is not None
        snapshot = self.pause.snapshot
        self._go_on(lambda: snapshot.resume({"return_value": None}))

    def close(self) -> None:
        self.pause = None
        self._stack.close()

    def _go_on(self, begin: Callable[[], object]) -> None:
        try:
            with self._ours.time.running(), self._ours.errors_of(self._name):
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


class _Ours:
    """Functions of ours whose own errors pass through a program unchanged, whatever it does with exceptions."""

    def __init__(self, program: str, functions: Functions, time: ProgramTime) -> None:
        self.time, self._program = time, program
        self._error: CarecontactError | None = None
        self.table: dict[str, Any] = {name: self._watched(name, function) for name, function in functions.items()}

    @contextmanager
    def errors_of(self, name: str) -> Generator[None, None, None]:
        try:
            yield
        except MontyError as error:
            if self._error is None:
                # Its own limit was what the step had left: then that is what stopped it.
                self.time.check(name)
            raise self._error or _stopped(name, error) from None
        if self._error is not None:
            raise self._error

    def _watched(self, name: str, function: Callable[..., object]) -> Callable[..., object]:
        signature = inspect.signature(function)

        def watched(*args: object, **kwargs: object) -> object:
            if self._error is not None:
                raise RuntimeError("this program is being stopped")
            bound(name, signature, args, kwargs)
            try:
                self.time.check(self._program)
                return function(*args, **kwargs)
            except CarecontactError as error:
                self._error = error
                raise RuntimeError(str(error)) from None

        return watched


def bound(
    name: str, signature: inspect.Signature, args: tuple[object, ...], kwargs: Mapping[str, object]
) -> inspect.BoundArguments:
    """The arguments of a call in a program. Raises TypeError that tells how ``name`` is called."""
    try:
        return signature.bind(*args, **kwargs)
    except TypeError as error:
        bare = [p.replace(annotation=inspect.Parameter.empty) for p in signature.parameters.values()]
        raise TypeError(f"{error}; it is {name}{inspect.Signature(bare)}") from None


def _checked(name: str, code: str) -> str:
    if len(code) > MAX_PROGRAM_CHARS:
        raise ProgramError(f"program {name}: {len(code)} characters, at most {MAX_PROGRAM_CHARS} are run")
    return code


def _stopped(name: str, error: MontyError) -> ProgramError:
    line = ""
    if isinstance(error, MontyRuntimeError | MontySyntaxError):
        said = error.display("type-msg").replace("feed time limit", "time limit")
        said = said.replace(f"suspension limit {MAX_CALLS} exceeded", f"more than {MAX_CALLS} calls")
        frames = error.traceback()
        if frames:
            line = f" (line {frames[-1].line}: {(frames[-1].source_line or '').strip():.120})"
    elif isinstance(error, MontyCrashedError):
        said = "hung and was killed" if error.timed_out else "brought its interpreter down"
    else:
        said = f"{type(error).__name__}: {error}"
    return ProgramError(f"program {name} was stopped: {' '.join(said.split()):.400}{line}")
