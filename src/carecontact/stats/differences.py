"""Intervals of a difference of two rates, from the Wilson intervals of both."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from carecontact.stats.proportions import Proportion, wilson_interval


@dataclass(frozen=True, kw_only=True)
class RateDifference:
    """First rate minus second, as fractions. Without trials there is no estimate, and the interval is [-1, 1]."""

    estimate: float | None
    low: float
    high: float
    confidence: float


def paired_difference(
    *, both: int, only_first: int, only_second: int, neither: int, confidence: float = 0.95
) -> RateDifference:
    """Difference of two rates over the same trials, from the counts of pairs.

    Newcombe, Statistics in Medicine 17:2635 (1998), method 10: Wilson intervals squared and added, with the correlation
    of the pairs taken off after a continuity correction. Raises ValueError for a negative count or unless 0 <
    confidence < 1.
    """
    counts = (both, only_first, only_second, neither)
    if min(counts) < 0:
        raise ValueError(f"pairs {counts}; expected counts from 0 up")
    n = sum(counts)
    product = (both + only_first) * (only_second + neither) * (both + only_second) * (only_first + neither)
    excess = both * neither - only_first * only_second
    if excess > 0:
        excess = max(excess - n / 2, 0.0)
    phi = excess / sqrt(product) if product else 0.0
    return _square_and_add(
        wilson_interval(both + only_first, n, confidence), wilson_interval(both + only_second, n, confidence), phi
    )


def unpaired_difference(k1: int, n1: int, k2: int, n2: int, confidence: float = 0.95) -> RateDifference:
    """Difference of k1 of n1 and k2 of n2 from independent trials.

    Newcombe, Statistics in Medicine 17:873 (1998), method 10. Raises ValueError unless 0 <= k <= n for both and 0 <
    confidence < 1.
    """
    return difference_of_rates(wilson_interval(k1, n1, confidence), wilson_interval(k2, n2, confidence))


def difference_of_rates(first: Proportion, second: Proportion) -> RateDifference:
    """Difference of two independent rates whose intervals are given, whatever they are over.

    The same squares and sums with other intervals than Wilson's: Zou & Donner, Statistics in Medicine 27:1693 (2008).
    """
    return _square_and_add(first, second, 0.0)


def _square_and_add(first: Proportion, second: Proportion, phi: float) -> RateDifference:
    confidence = first.confidence
    if first.estimate is None or second.estimate is None:
        return RateDifference(estimate=None, low=-1.0, high=1.0, confidence=confidence)
    estimate = first.estimate - second.estimate
    down = _length(first.estimate - first.low, second.high - second.estimate, phi)
    up = _length(first.high - first.estimate, second.estimate - second.low, phi)
    return RateDifference(
        estimate=estimate, low=max(estimate - down, -1.0), high=min(estimate + up, 1.0), confidence=confidence
    )


def _length(a: float, b: float, phi: float) -> float:
    # For phi = 1 and a = b rounding could leave -1e-18 under the root.
    return sqrt(max(a * a - 2 * phi * a * b + b * b, 0.0))
