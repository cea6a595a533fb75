"""Tests whether a ranking of methods stays the same when a chosen parameter is varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from carecontact.stats.values import complete_pairs


@dataclass(frozen=True, kw_only=True)
class KendallTau:
    tau: float | None
    """tau-b: 1 for the same order, -1 for the reverse; None where a side has one value only, so no order."""
    pvalue: float | None
    """Two-sided; exact for small samples without ties, else by the normal approximation."""
    n: int
    """Pairs with both values."""


@dataclass(frozen=True, kw_only=True)
class RankingSweep:
    reference: str
    tau: dict[str, KendallTau]
    """Level of the sweep -> its ranking against that at the reference."""
    least: float | None
    """The smallest tau of all levels; None if none is defined."""


def kendall_tau(first: Sequence[float | None], second: Sequence[float | None]) -> KendallTau:
    """Kendall's tau-b, which corrects for ties (Kendall, Biometrika 33:239, 1945), over pairs with both values.

    Raises ValueError for lengths that differ or NaN.
    """
    a, b, _ = complete_pairs(first, second)
    if len(set(a)) < 2 or len(set(b)) < 2:
        return KendallTau(tau=None, pvalue=None, n=len(a))
    result: Any = import_module("scipy.stats").kendalltau(a, b)
    return KendallTau(tau=float(result.statistic), pvalue=float(result.pvalue), n=len(a))


def ranking_sweep(sweep: Mapping[str, Mapping[str, float | None]], *, reference: str) -> RankingSweep:
    """``sweep`` maps a level (``gamma 0.35``) to the scores of the methods there; a method without a score at one of
    two levels is in neither ranking.

    Raises ValueError if the reference is not a level or a level has other methods, and for NaN.
    """
    if reference not in sweep:
        raise ValueError(f"reference {reference!r}; expected a level of the sweep: {', '.join(sweep)}")
    methods = sorted(sweep[reference])
    for level, scores in sweep.items():
        if sorted(scores) != methods:
            raise ValueError(f"level {level!r} has {sorted(scores)}; expected the methods {methods}")
    base = [sweep[reference][m] for m in methods]
    found = {level: kendall_tau(base, [scores[m] for m in methods]) for level, scores in sweep.items()}
    defined = [row.tau for row in found.values() if row.tau is not None]
    return RankingSweep(reference=reference, tau=found, least=min(defined, default=None))
