"""Tests whether two methods differ in a rate, trial by trial."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from carecontact.stats.values import check_count


@dataclass(frozen=True, kw_only=True)
class McNemar:
    pvalue: float
    """Two-sided, exact; 1 without discordant pairs: nothing then speaks against equality."""
    only_first: int
    """Pairs in which the first method alone succeeded."""
    only_second: int


def mcnemar_exact(only_first: int, only_second: int) -> McNemar:
    """Exact McNemar test (McNemar 1947; exact by the binomial of the discordant pairs at 1/2, the sign test).

    Pairs that agree do not enter. Raises ValueError unless both are whole numbers from 0 up.
    """
    only_first, only_second = (check_count("discordant pairs", k) for k in (only_first, only_second))
    n = only_first + only_second
    result: Any = import_module("scipy.stats").binomtest(only_first, n, 0.5) if n else None
    return McNemar(
        pvalue=1.0 if result is None else float(result.pvalue), only_first=only_first, only_second=only_second
    )
