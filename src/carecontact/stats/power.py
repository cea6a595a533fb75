"""The smallest difference that a comparison could have detected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from math import sqrt
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.stats.values import check_level

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
    binom: Any = import_module("scipy.stats").binom
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
    """Return the difference at which the power, which grows with it, reaches ``power``; None if it does not up to
    ``largest``.

    By bisection and not by scipy's root finding: the returned difference does reach the power, also where the power
    jumps, and the published results keep their last digits.
    """
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
