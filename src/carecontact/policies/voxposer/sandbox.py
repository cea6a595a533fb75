"""Runs what a language model wrote, with limits on time, memory and calls."""

from __future__ import annotations

import datetime
import inspect
import time
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

# How long the programs of one step may take together, without the time that a language model takes.


class ProgramTime:
    """A stopwatch over programs that call each other.

    Each program has a limit of its own, but one may call a thousand others, and a call of the policy that misses its
    deadline leaves no notes.
    """

    def __init__(self, limit_s: float) -> None:
        """``limit_s``: for all programs of one step together [s]."""
        self.limit_s = limit_s
        self._depth, self._since = 0, 0.0
        self._used_s = 0.0

    def start_over(self) -> None:
        """Begin a step: nothing is used yet."""
        self._used_s = 0.0

    @property
    def left_s(self) -> float:
        """Time that the programs of this step have left [s]; negative once it is used up."""
        running_s = time.monotonic() - self._since if self._depth else 0.0
        return self.limit_s - self._used_s - running_s

    def check(self, name: str) -> None:
        """Raise ProgramError if the program called ``name`` may not go on."""
        if self.left_s <= 0:
            raise ProgramError(
                f"program {name} was stopped: the programs of one step took more than {self.limit_s:g} s together"
            )

    @contextmanager
    def running(self) -> Generator[None, None, None]:
        """Count the time while a program runs; programs that it calls run inside and count once."""
        if self._depth == 0:
            self._since = time.monotonic()
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                self._used_s += time.monotonic() - self._since

    @contextmanager
    def not_counted(self) -> Generator[None, None, None]:
        """Stop counting while a language model is asked."""
        began = time.monotonic()
        try:
            yield
        finally:
            self._since += time.monotonic() - began


# Functions of ours that a program in the sandbox may call, and how their errors leave the sandbox.

MAX_CALLS = 2000
"""Calls of our functions that one program may make."""

Functions = Mapping[str, Callable[..., object]]


class HostFunctions:
    """The functions that one program may call.

    Their own errors pass through the program unchanged, whatever the program does with exceptions. Once a function has
    raised a CarecontactError, every further call stops the program.
    """

    def __init__(self, program: str, functions: Functions, time: ProgramTime) -> None:
        self.time, self._program = time, program
        self._error: CarecontactError | None = None
        self.table: dict[str, Any] = {name: self._watched(name, function) for name, function in functions.items()}

    @contextmanager
    def errors_of(self, name: str) -> Generator[None, None, None]:
        """Turn what stops the program called ``name`` into a ProgramError, and raise an error of ours as it is."""
        try:
            yield
        except MontyError as error:
            if self._error is None:
                # The program's own limit may have been what the step had left; then the step's limit is the reason.
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
    """Return the arguments of a call in a program. Raises TypeError that shows how ``name`` is called."""
    try:
        return signature.bind(*args, **kwargs)
    except TypeError as error:
        bare = [p.replace(annotation=inspect.Parameter.empty) for p in signature.parameters.values()]
        raise TypeError(f"{error}; the call is {name}{inspect.Signature(bare)}") from None


def _stopped(name: str, error: MontyError) -> ProgramError:
    line = ""
    if isinstance(error, MontyRuntimeError | MontySyntaxError):
        said = error.display("type-msg").replace("feed time limit", "time limit")
        said = said.replace(f"suspension limit {MAX_CALLS} exceeded", f"more than {MAX_CALLS} calls")
        frames = error.traceback()
        if frames:
            line = f" (line {frames[-1].line}: {(frames[-1].source_line or '').strip():.120})"
    elif isinstance(error, MontyCrashedError):
        said = "it hung and was killed" if error.timed_out else "it crashed its interpreter"
    else:
        said = f"{type(error).__name__}: {error}"
    return ProgramError(f"program {name} was stopped: {' '.join(said.split()):.400}{line}")


# Runs programs that a language model wrote: in another process and interpreter, with limits on everything.

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
