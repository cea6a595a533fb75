"""How long the programs of one step may take together; what a language model takes is not theirs."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

from carecontact.errors import ProgramError


class ProgramTime:
    """A stopwatch over programs that call each other. Each has a limit of its own, but one may call a thousand others,
    and a call of the policy that misses its deadline leaves no notes."""

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._depth, self._since = 0, 0.0
        self._used_s = 0.0

    def start_over(self) -> None:
        """At each step."""
        self._used_s = 0.0

    @property
    def left_s(self) -> float:
        running_s = time.monotonic() - self._since if self._depth else 0.0
        return self.limit_s - self._used_s - running_s

    def check(self, name: str) -> None:
        """Raises ProgramError if the program called ``name`` may not go on."""
        if self.left_s <= 0:
            raise ProgramError(
                f"program {name} was stopped: the programs of one step took more than {self.limit_s:g} s together"
            )

    @contextmanager
    def running(self) -> Generator[None, None, None]:
        """While a program runs; those that it calls are inside and count once."""
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
        began = time.monotonic()
        try:
            yield
        finally:
            self._since += time.monotonic() - began
