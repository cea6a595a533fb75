"""One part of a run's trials, for machines that share nothing but the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self, TypeVar

from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError

Cell = TypeVar("Cell")
EXPECTED = "expected I/N with I from 1 to N, for example 2/4 for the second of four parts"


@dataclass(frozen=True, kw_only=True)
class Shard:
    index: int
    """Number of the part, from 1 to ``count``."""
    count: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """``2/4`` is the second of four parts. Raises ConfigError for anything else."""
        index, slash, count = (part.strip() for part in text.partition("/"))
        if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
            raise ConfigError(f"--shard {text}: {EXPECTED}")
        return cls(index=int(index), count=int(count))

    def of(self, specs: Sequence[TrialSpec]) -> list[TrialSpec]:
        """Return the trials of this part, neighbours in the order of the plan; parts differ by one trial at most.

        Raises ConfigError where there are more parts than trials.
        """
        if self.count > len(specs):
            raise ConfigError(
                f"--shard {self.index}/{self.count}: there are {len(specs)} trials; give at most as many parts"
            )
        begin, end = (len(specs) * k // self.count for k in (self.index - 1, self.index))
        return list(specs[begin:end])

    def every(self, cells: Sequence[Cell]) -> list[Cell]:
        """Return the cells of a sweep that belong to this part, every ``count``-th one: 2/4 has the second, the sixth
        and so on.

        Raises ConfigError where there are more parts than cells.
        """
        if self.count > len(cells):
            raise ConfigError(
                f"--shard {self.index}/{self.count}: there are {len(cells)} cells; give at most as many parts"
            )
        return list(cells[self.index - 1 :: self.count])
