"""Whether two methods differ in a rate, trial by trial."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True, kw_only=True)
class McNemar:
    pvalue: float
    """Two-sided, exact; 1 without discordant pairs, which say nothing against equality."""
    only_first: int
    """Pairs in which the first method alone succeeded."""
    only_second: int


def mcnemar_exact(only_first: int, only_second: int) -> McNemar:
    """Exact McNemar test (McNemar 1947; exact by the binomial of the discordant pairs at 1/2, the sign test).

    Pairs that agree do not enter. Raises ValueError if a count is negative.
    """
    if only_first < 0 or only_second < 0:
        raise ValueError(f"discordant pairs {only_first} and {only_second}; expected counts from 0 up")
    n = only_first + only_second
    result: Any = import_module("scipy.stats").binomtest(only_first, n, 0.5) if n else None
    return McNemar(
        pvalue=1.0 if result is None else float(result.pvalue), only_first=only_first, only_second=only_second
    )
