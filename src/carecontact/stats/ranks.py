"""Tests on ranks and signs: paired differences with failures as worst ranks, contrasts, and the agreement of orders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, sqrt
from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.stats.values import check_counts, check_pairs, check_values, complete_pairs, scipy_stats


@dataclass(frozen=True, kw_only=True)
class SignFlip:
    pvalue: float | None
    """Two-sided, exact; 1 if all differences are 0, None without persons."""
    n: int
    """Persons."""
    n_unequal: int
    """Number of persons with a difference; only these decide."""


def sign_flip(differences: Sequence[int]) -> SignFlip:
    """Exact permutation test of whole persons (Fisher, The Design of Experiments, 1935, 21).

    Under the null hypothesis either method could have had either result on a person, so each difference has either sign
    with 1/2, all tasks of the person together. The p-value is the probability of a sum at least as far from 0, found by
    adding person after person. With one trial a person, it is McNemar's exact test. Raises ValueError for a difference
    that is no whole number.

    Args:
        differences: (K,) of each person: trials that the first method passed minus those that the second did.
    """
    whole = [int(value) for value in differences]
    if any(a != b for a, b in zip(whole, differences, strict=True)):
        raise ValueError("a difference is no whole number; expected counts of trials")
    sizes = [abs(value) for value in whole if value]
    if not sizes:
        return SignFlip(pvalue=1.0 if whole else None, n=len(whole), n_unequal=0)
    total = sum(sizes)
    distance = np.abs(2 * np.arange(total + 1) - total)
    pvalue = min(1.0, float(_chance_of_sums(sizes)[distance >= abs(sum(whole))].sum()))
    return SignFlip(pvalue=pvalue, n=len(whole), n_unequal=len(sizes))


def _chance_of_sums(sizes: Sequence[int]) -> npt.NDArray[np.float64]:
    """Probability of each sum of the sizes that have a plus, where each has either sign with 1/2."""
    probability = np.zeros(sum(sizes) + 1)
    probability[0] = 1.0
    for size in sizes:
        shifted = probability[:-size] / 2
        probability /= 2
        probability[size:] += shifted
    return probability


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
    stats = scipy_stats()
    ranks = [float(r) for r in stats.rankdata([abs(d) for d in differences])]
    signed = [r if d > 0 else -r for r, d in zip(ranks, differences, strict=True)]
    larger, smaller = sum((r for r in signed if r > 0), 0.0), sum((-r for r in signed if r < 0), 0.0)
    if clusters is not None:
        pvalue = _of_clusters(signed, [clusters[kept[i]] for i in unequal])
    elif len(signed) <= EXACT_UP_TO:
        # Ranks of ties lie between two whole numbers.
        sums = _chance_of_sums([round(2 * rank) for rank in ranks])
        pvalue = 2 * float(sums[: round(2 * min(larger, smaller)) + 1].sum())
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
    result = scipy_stats().fisher_exact([[k1, n1 - k1], [k2, n2 - k2]])
    return FisherExact(pvalue=float(result.pvalue), odds_ratio=float(result.statistic))


def mann_whitney(first: Sequence[float], second: Sequence[float]) -> MannWhitney:
    """Two-sided Mann-Whitney U test. Raises ValueError if a sample is empty or holds NaN."""
    if not first or not second:
        raise ValueError(f"samples of {len(first)} and {len(second)}; expected at least one value in each")
    check_values(first)
    check_values(second)
    result = scipy_stats().mannwhitneyu(first, second, alternative="two-sided")
    return MannWhitney(pvalue=float(result.pvalue), statistic=float(result.statistic))


# Compares scores that exist only where the person was touched, over all trials: no score counts as the worst score.

Side = Literal["first", "second", "neither"]


@dataclass(frozen=True, kw_only=True)
class WorstRank:
    pvalue: float | None
    """Two-sided; None without pairs."""
    better: Side
    """The method that the ranks favour, whether significantly or not."""
    n: int
    n_only_first: int
    """Pairs in which the first method alone has a score."""
    n_only_second: int


def worst_rank_paired(
    first: Sequence[float | None],
    second: Sequence[float | None],
    *,
    better: Literal["higher", "lower"],
    clusters: Sequence[int] | None = None,
) -> WorstRank:
    """Signed-rank test in which None ranks below every score; two None are an equal pair.

    A pair with one score is the largest difference there is, all such pairs tied. The composite of Lachin, Controlled
    Clinical Trials 20:408 (1999), with the signed-rank test for his rank-sum test because trials are paired. A method
    that never scores cannot win by leaving out the hard trials. ``clusters`` as in ``signed_rank``. Raises ValueError
    for lengths that differ or NaN.
    """
    check_pairs(first, second)
    found = signed_rank(_filled(first, better), _filled(second, better), clusters=clusters)
    larger, smaller = ("first", "second") if better == "higher" else ("second", "first")
    order = found.rank_sum_first - found.rank_sum_second
    pairs = list(zip(first, second, strict=True))
    return WorstRank(
        pvalue=found.pvalue,
        better=larger if order > 0 else smaller if order < 0 else "neither",
        n=len(pairs),
        n_only_first=sum(a is not None and b is None for a, b in pairs),
        n_only_second=sum(a is None and b is not None for a, b in pairs),
    )


def worst_rank_unpaired(
    first: Sequence[float | None], second: Sequence[float | None], *, better: Literal["higher", "lower"]
) -> MannWhitney:
    """Mann-Whitney U test in which None ranks below every score (Lachin 1999), for trials that are not paired.

    Raises ValueError if a sample is empty or holds NaN.
    """
    check_values(first)
    check_values(second)
    return mann_whitney(_filled(first, better), _filled(second, better))


def _filled(values: Sequence[float | None], better: Literal["higher", "lower"]) -> list[float]:
    worst = -inf if better == "higher" else inf
    return [worst if value is None else value for value in values]


# Tests whether a ranking of methods stays the same when a chosen parameter is varied.


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
    result = scipy_stats().kendalltau(a, b)
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
