"""Rates and their intervals."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

from carecontact.stats.values import check_counts


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
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence}; expected between 0 and 1")
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
