"""How long the programs of one step may take together, without the time that a language model takes."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

from carecontact.errors import ProgramError


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
