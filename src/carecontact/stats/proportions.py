"""Rates: Wilson intervals, differences of paired rates, McNemar's test, and the power of a comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from carecontact.stats.values import check_count, check_counts, check_level, scipy_stats


@dataclass(frozen=True, kw_only=True)
class Proportion:
    """k of n with an interval. Without trials (n = 0) there is no estimate, and the interval is [0, 1]."""

    k: int
    n: int
    confidence: float
    estimate: float | None
    low: float
    high: float


def wilson_interval(k: int, n: int, confidence: float = 0.95) -> Proportion:
    """Wilson score interval without continuity correction (Wilson 1927) for ``k`` successes of ``n``.

    Raises ValueError unless k and n are whole numbers, 0 <= k <= n and 0 < confidence < 1.
    """
    k, n = check_counts(k, n)
    check_level("confidence", confidence)
    if n == 0:
        return Proportion(k=k, n=n, confidence=confidence, estimate=None, low=0.0, high=1.0)
    z2 = NormalDist().inv_cdf(0.5 + confidence / 2) ** 2
    p = k / n
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = sqrt(z2 * (p * (1 - p) + z2 / (4 * n)) / n) / (1 + z2 / n)
    # At the ends the interval touches 0 or 1 exactly; rounding would leave 1e-17 there.
    low = 0.0 if k == 0 else centre - half
    high = 1.0 if k == n else centre + half
    return Proportion(k=k, n=n, confidence=confidence, estimate=p, low=low, high=high)


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
    # In whole numbers: every run's page has such tests, and scipy takes longer to import than the page to make.
    term = total = 1
    for k in range(1, min(only_first, only_second) + 1):
        term = term * (n - k + 1) // k
        total += term
    pvalue = min(1.0, 2 * total / 2**n)
    return McNemar(pvalue=pvalue, only_first=only_first, only_second=only_second)


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


# The smallest difference that a comparison could have detected.

POWER = 0.8
ALPHA = 0.05
BISECTIONS = 30


@dataclass(frozen=True, kw_only=True)
class DetectableDifference:
    difference: float | None
    """Smallest one that a two-sided test at ``alpha`` finds with ``power``; None if no difference is large enough."""
    power: float
    alpha: float


def paired_detectable_difference(
    *, n: int, discordance: float, power: float = POWER, alpha: float = ALPHA
) -> DetectableDifference:
    """Smallest difference of two rates over ``n`` pairs that the exact McNemar test finds, as a fraction.

    ``discordance`` is the share of pairs in which one method alone succeeds; a difference above it takes as much
    discordance as itself. The power is exact and unconditional: the conditional power (Miettinen, Biometrics 24:339,
    1968) of each number of discordant pairs, weighted by its binomial probability.
    Raises ValueError for n < 0 or a share outside its range.
    """
    _check(power, alpha)
    if n < 0 or not 0 <= discordance <= 1:
        raise ValueError(f"n = {n}, discordance = {discordance}; expected n >= 0 and 0 <= discordance <= 1")
    binom = scipy_stats().binom
    discordant = np.arange(n + 1)
    # Reject if the smaller count is at most this: -1 where even 0 would not do. ppf lies one above unless on alpha / 2.
    critical: npt.NDArray[np.float64] = binom.ppf(alpha / 2, discordant, 0.5)
    critical = np.where(binom.cdf(critical, discordant, 0.5) <= alpha / 2, critical, critical - 1)

    def power_at(difference: float) -> float:
        total = max(discordance, difference)
        share = (1 + difference / total) / 2 if total else 0.5
        found = binom.cdf(critical, discordant, 1 - share) + binom.cdf(critical, discordant, share)
        return float((found * binom.pmf(discordant, n, total)).sum())

    return DetectableDifference(difference=_smallest(power_at, power, 1.0), power=power, alpha=alpha)


def unpaired_detectable_difference(
    *, n1: int, n2: int, rate: float, power: float = POWER, alpha: float = ALPHA
) -> DetectableDifference:
    """Smallest difference from ``rate`` that a comparison of n1 with n2 independent trials finds, as a fraction.

    Two proportions by the normal approximation without continuity correction (Fleiss, Levin & Paik, Statistical
    Methods for Rates and Proportions, 3rd ed. 2003, ch. 4); Fisher's exact test needs somewhat more. The other rate
    lies toward 1/2 and beyond, where there is room. Raises ValueError for n < 0 or a share outside its range.
    """
    _check(power, alpha)
    if n1 < 0 or n2 < 0 or not 0 <= rate <= 1:
        raise ValueError(f"n = {n1} and {n2}, rate = {rate}; expected n >= 0 and 0 <= rate <= 1")
    if not n1 or not n2:
        return DetectableDifference(difference=None, power=power, alpha=alpha)
    normal = NormalDist()
    z = normal.inv_cdf(1 - alpha / 2)
    p = min(rate, 1 - rate)

    def power_at(difference: float) -> float:
        q = p + difference
        mean = (n1 * p + n2 * q) / (n1 + n2)
        under_null = sqrt(max(mean * (1 - mean), 0.0) * (1 / n1 + 1 / n2))
        spread = sqrt(max(p * (1 - p) / n1 + q * (1 - q) / n2, 0.0))
        if spread == 0:
            return float(difference > z * under_null)
        return normal.cdf((difference - z * under_null) / spread)

    return DetectableDifference(difference=_smallest(power_at, power, 1 - p), power=power, alpha=alpha)


def detectable_from_standard_error(
    standard_error: float, *, power: float = POWER, alpha: float = ALPHA
) -> DetectableDifference:
    """Smallest difference found when its estimate is normal with this standard error, in the same unit.

    (z_{1 - alpha/2} + z_power) SE: Bloom, Evaluation Review 19:547 (1995). Raises ValueError for a negative error or a
    share outside its range.
    """
    _check(power, alpha)
    if not standard_error >= 0:
        raise ValueError(f"standard error {standard_error}; expected at least 0")
    normal = NormalDist()
    factor = normal.inv_cdf(1 - alpha / 2) + normal.inv_cdf(power)
    return DetectableDifference(difference=factor * standard_error, power=power, alpha=alpha)


def _smallest(power_at: Callable[[float], float], power: float, largest: float) -> float | None:
    """Return the least difference with which ``power`` is reached, also where the power jumps; None if it is not up to
    ``largest``."""
    if power_at(largest) < power:
        return None
    low, high = 0.0, largest
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if power_at(middle) >= power else (middle, high)
    return high


def _check(power: float, alpha: float) -> None:
    check_level("power", power)
    check_level("alpha", alpha)
