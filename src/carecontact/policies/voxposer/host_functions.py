"""Functions of ours that a program in the sandbox may call, and how their errors leave the sandbox."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any

from pydantic_monty import MontyCrashedError, MontyError, MontyRuntimeError, MontySyntaxError

from carecontact.errors import CarecontactError, ProgramError
from carecontact.policies.voxposer.program_time import ProgramTime

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
