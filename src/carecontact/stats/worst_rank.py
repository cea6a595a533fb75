"""Compares scores that exist only where the person was touched, over all trials: no score counts as the worst score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal

from carecontact.stats.contrasts import MannWhitney, mann_whitney
from carecontact.stats.values import check_pairs, check_values
from carecontact.stats.wilcoxon import signed_rank

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
    worst = _worst(better)
    found = signed_rank(_filled(first, worst), _filled(second, worst), clusters=clusters)
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
    return mann_whitney(_filled(first, _worst(better)), _filled(second, _worst(better)))


def _worst(better: Literal["higher", "lower"]) -> float:
    return -inf if better == "higher" else inf


def _filled(values: Sequence[float | None], worst: float) -> list[float]:
    return [worst if value is None else value for value in values]
