"""Unpaired contrasts between two methods, as the paper makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from carecontact.stats.values import check_counts, check_values


@dataclass(frozen=True, kw_only=True)
class FisherExact:
    pvalue: float
    """Two-sided."""
    odds_ratio: float
    """Sample odds ratio; infinite when a cell of its denominator is 0, NaN when it is undefined."""


@dataclass(frozen=True, kw_only=True)
class MannWhitney:
    pvalue: float
    """Two-sided; exact for small samples without ties, else by the normal approximation with tie correction."""
    statistic: float
    """U of the first sample."""


def fisher_exact(k1: int, n1: int, k2: int, n2: int) -> FisherExact:
    """Two-sided Fisher exact test of k1 of n1 against k2 of n2.

    Raises ValueError unless both are whole numbers with 0 <= k <= n.
    """
    (k1, n1), (k2, n2) = check_counts(k1, n1), check_counts(k2, n2)
    result: Any = import_module("scipy.stats").fisher_exact([[k1, n1 - k1], [k2, n2 - k2]])
    return FisherExact(pvalue=float(result.pvalue), odds_ratio=float(result.statistic))


def mann_whitney(first: Sequence[float], second: Sequence[float]) -> MannWhitney:
    """Two-sided Mann-Whitney U test. Raises ValueError if a sample is empty or holds NaN."""
    if not first or not second:
        raise ValueError(f"samples of {len(first)} and {len(second)}; expected at least one value in each")
    check_values(first)
    check_values(second)
    result: Any = import_module("scipy.stats").mannwhitneyu(first, second, alternative="two-sided")
    return MannWhitney(pvalue=float(result.pvalue), statistic=float(result.statistic))
