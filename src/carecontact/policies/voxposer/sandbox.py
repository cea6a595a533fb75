"""Runs what a language model wrote, with limits on time, memory and calls."""

from __future__ import annotations

import datetime
import inspect
import time
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import pydantic_monty as monty

from carecontact.errors import CarecontactError, ProgramError


class ProgramTime:
    """A stopwatch over programs that call each other, without the time that a language model takes.

    Each program has a limit of its own, but one may call a thousand others, and a call of the policy that misses its
    deadline leaves no notes.
    """

    def __init__(self, limit_s: float) -> None:
        """``limit_s``: for all programs of one step together [s]."""
        self.limit_s = limit_s
        self._depth, self._since, self._used_s = 0, 0.0, 0.0

    def start_over(self) -> None:
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
    def errors(self) -> Generator[None, None, None]:
        """Turn the end of a stopped program into a ProgramError, and raise an error of ours as it is."""
        try:
            yield
        except monty.MontyError as error:
            if self._error is None:
                # The program's own limit may have been what the step had left; then the step's limit is the reason.
                self.time.check(self._program)
            raise self._error or _stopped(self._program, error) from None
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


def _stopped(name: str, error: monty.MontyError) -> ProgramError:
    line = ""
    if isinstance(error, monty.MontyRuntimeError | monty.MontySyntaxError):
        reason = error.display("type-msg").replace("feed time limit", "time limit")
        reason = reason.replace(f"suspension limit {MAX_CALLS} exceeded", f"more than {MAX_CALLS} calls")
        frames = error.traceback()
        if frames:
            line = f" (line {frames[-1].line}: {(frames[-1].source_line or '').strip():.120})"
    elif isinstance(error, monty.MontyCrashedError):
        reason = "it hung and was killed" if error.timed_out else "it crashed its interpreter"
    else:
        reason = f"{type(error).__name__}: {error}"
    return ProgramError(f"program {name} was stopped: {' '.join(reason.split()):.400}{line}")


LIMITS = monty.ResourceLimits(
    max_feed_duration_secs=2.0, max_memory=64 << 20, max_recursion_depth=200, max_suspensions=MAX_CALLS
)
"""Limits of one program. Programs need milliseconds and kilobytes, because their calls do the work here."""
STEP_S = 10.0
"""Limit of all programs of one step together, including those that programs call: a third of the shortest deadline of
a call in bathing-v3."""
REQUEST_S = 10.0
"""A worker that does not answer for this long is killed."""
PRINTED_BYTES = 65536
MAX_PROGRAM_CHARS = 20_000
OS_POLICY = monty.OSPolicy(datetime=datetime.datetime(2000, 1, 1), sleep="zero", random_start={"seed": 0})
"""No clock, no waiting and no random numbers: the same program does the same thing each time."""
RESULT = "ret_val"


class Sandbox:
    """A pool of interpreters without files, network, or any module of Python's but harmless ones.

    A program sees objects of ours as handles with the attributes that are offered, and hands them back as themselves.
    Every method that runs a program raises ProgramError, which names the program, what it did and in which line. An
    error of carecontact that a called function raises comes out as it is.
    """

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._pool = self._stack.enter_context(monty.Monty(max_processes=3, request_timeout=REQUEST_S))
        self.time = ProgramTime(STEP_S)

    def close(self) -> None:
        self._stack.close()

    def value(self, name: str, code: str, functions: Functions) -> object:
        """Run the program called ``name``, and return what it leaves in ``ret_val``."""
        host = self._host(name, code, functions)
        shortest = min(LIMITS.get("max_feed_duration_secs") or STEP_S, self.time.left_s)
        limits: monty.ResourceLimits = {**LIMITS, "max_feed_duration_secs": shortest}
        with self.time.running(), host.errors(), self._session(limits) as session:
            return session.feed_run(
                f"{code}\n{RESULT}", external_lookup=host.table, print_callback=monty.CollectString(PRINTED_BYTES)
            )

    def run(self, name: str, code: str, functions: Functions) -> None:
        """Run the program called ``name`` for the functions that it calls."""
        self.value(name, f"{code}\n{RESULT} = None", functions)

    def calls(
        self, name: str, code: str, functions: Functions, *, pause_at: Collection[str]
    ) -> Iterator[monty.FunctionSnapshot]:
        """Run the program called ``name``, and yield each of its calls of ``pause_at``, which are names in
        ``functions``. Meanwhile the program waits; then the call returns None.
        """
        host, printed = self._host(name, code, functions), monty.CollectString(PRINTED_BYTES)
        with self._session(LIMITS) as session:
            go_on = partial(session.feed_start, code, external_lookup=host.table, print_callback=printed)
            while True:
                with self.time.running(), host.errors():
                    snapshot: Any = go_on()
                    while not isinstance(snapshot, monty.MontyComplete) and not _calls(snapshot, pause_at):
                        snapshot = snapshot.resume_auto()
                if isinstance(snapshot, monty.MontyComplete):
                    return
                yield snapshot
                go_on = partial(snapshot.resume, {"return_value": None})

    def _host(self, name: str, code: str, functions: Functions) -> HostFunctions:
        self.time.check(name)
        if len(code) > MAX_PROGRAM_CHARS:
            raise ProgramError(f"program {name}: it has {len(code)} characters; at most {MAX_PROGRAM_CHARS} are run")
        return HostFunctions(name, functions, self.time)

    def _session(self, limits: monty.ResourceLimits) -> monty.MontySession:
        return self._pool.checkout(limits=limits, os_policy=OS_POLICY)


def _calls(snapshot: object, names: Collection[str]) -> bool:
    return isinstance(snapshot, monty.FunctionSnapshot) and snapshot.function_name in names
