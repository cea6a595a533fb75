"""Tests whether two methods differ in a score, trial by trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from carecontact.stats.values import complete_pairs

EXACT_UP_TO = 400
"""Unequal pairs; the exact distribution needs memory that grows with their square and time with their cube."""


@dataclass(frozen=True, kw_only=True)
class SignedRank:
    pvalue: float | None
    """Two-sided; 1 if all pairs are equal, None without pairs."""
    rank_sum_first: float
    """Sum of the ranks of the pairs in which the first value is larger."""
    rank_sum_second: float
    n: int
    """Pairs with both values."""
    n_unequal: int
    """How many of these pairs differ; only these are ranked."""


def signed_rank(first: Sequence[float | None], second: Sequence[float | None]) -> SignedRank:
    """Wilcoxon signed-rank test (Wilcoxon 1945) over the pairs that have both values.

    Equal pairs are left out, as Wilcoxon did and as McNemar's test does. Exact, given the ranks, with ties too, which
    worst ranks make; beyond EXACT_UP_TO unequal pairs the normal approximation with tie correction. Infinite values are
    allowed: only ranks count, and two equal infinities are an equal pair. Raises ValueError for lengths that differ or
    NaN.
    """
    a, b, _ = complete_pairs(first, second)
    differences = [x - y for x, y in zip(a, b, strict=True) if x != y]
    if not differences:
        return SignedRank(pvalue=1.0 if a else None, rank_sum_first=0.0, rank_sum_second=0.0, n=len(a), n_unequal=0)
    stats: Any = import_module("scipy.stats")
    ranks = [float(r) for r in stats.rankdata([abs(d) for d in differences])]
    signed = [r if d > 0 else -r for r, d in zip(ranks, differences, strict=True)]
    larger, smaller = sum((r for r in signed if r > 0), 0.0), sum((-r for r in signed if r < 0), 0.0)
    if len(signed) <= EXACT_UP_TO:
        pvalue = _exact(ranks, min(larger, smaller))
    else:
        # The ranks stand for the differences: the same test, and infinity never meets scipy's arithmetic.
        pvalue = float(stats.wilcoxon(signed, method="asymptotic").pvalue)
    return SignedRank(
        pvalue=min(1.0, pvalue),
        rank_sum_first=larger,
        rank_sum_second=smaller,
        n=len(a),
        n_unequal=len(signed),
    )


def _exact(ranks: list[float], smaller: float) -> float:
    """2 P(T <= smaller) where each rank has either sign with 1/2, by adding rank after rank in units of 1/2."""
    steps = [round(2 * r) for r in ranks]
    probability = np.zeros(sum(steps) + 1)
    probability[0] = 1.0
    for step in steps:
        shifted = probability[:-step].copy()
        probability /= 2
        probability[step:] += shifted / 2
    return 2 * float(probability[: round(2 * smaller) + 1].sum())
