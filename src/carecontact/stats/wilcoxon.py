"""Tests whether two methods differ in a score, trial by trial or with all trials of a seed together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from math import sqrt
from statistics import NormalDist
from typing import Any

import numpy as np

from carecontact.stats.sign_flip import sign_flip
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


def signed_rank(
    first: Sequence[float | None], second: Sequence[float | None], *, clusters: Sequence[int] | None = None
) -> SignedRank:
    """Wilcoxon signed-rank test (Wilcoxon 1945) over the pairs that have both values.

    Equal pairs are left out, as Wilcoxon did and as McNemar's test does. Exact, given the ranks, with ties too, which
    worst ranks make; beyond EXACT_UP_TO unequal pairs the normal approximation with tie correction. Infinite values are
    allowed: only ranks count, and two equal infinities are an equal pair.

    With clusters, the signed ranks of a cluster are added and have either sign together (Rosner, Glynn & Lee,
    Biometrics 62:185, 2006): pairs of one cluster need not be independent. Exact as ``sign_flip`` is, up to as many
    pairs; beyond, the normal approximation over clusters.

    Args:
        clusters: (N,) the seed of each pair; None: every pair stands alone.

    Raises ValueError for lengths that differ or NaN.
    """
    a, b, kept = complete_pairs(first, second)
    if clusters is not None and len(clusters) != len(first):
        raise ValueError(f"{len(clusters)} clusters for {len(first)} pairs; expected one for each")
    unequal = [i for i, (x, y) in enumerate(zip(a, b, strict=True)) if x != y]
    differences = [a[i] - b[i] for i in unequal]
    if not differences:
        return SignedRank(pvalue=1.0 if a else None, rank_sum_first=0.0, rank_sum_second=0.0, n=len(a), n_unequal=0)
    stats: Any = import_module("scipy.stats")
    ranks = [float(r) for r in stats.rankdata([abs(d) for d in differences])]
    signed = [r if d > 0 else -r for r, d in zip(ranks, differences, strict=True)]
    larger, smaller = sum((r for r in signed if r > 0), 0.0), sum((-r for r in signed if r < 0), 0.0)
    if clusters is not None:
        pvalue = _of_clusters(signed, [clusters[kept[i]] for i in unequal])
    elif len(signed) <= EXACT_UP_TO:
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


def _of_clusters(signed: list[float], clusters: list[int]) -> float:
    """Two-sided, where the summed ranks of each cluster have either sign with 1/2."""
    sums: dict[int, float] = {}
    for rank, cluster in zip(signed, clusters, strict=True):
        sums[cluster] = sums.get(cluster, 0.0) + rank
    if len(signed) <= EXACT_UP_TO:
        # Ranks of ties lie between two whole numbers.
        return sign_flip([round(2 * value) for value in sums.values()]).pvalue or 0.0
    spread = sqrt(sum(value * value for value in sums.values()))
    return 2 * NormalDist().cdf(-abs(sum(sums.values())) / spread) if spread else 1.0


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
