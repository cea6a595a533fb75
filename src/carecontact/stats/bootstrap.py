"""Intervals of a paired difference from resampled seeds: all trials of one seed are drawn together."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.stats.strata import strata_of, stratified_weights
from carecontact.stats.values import check_level, complete_pairs

Statistic = Literal["median_difference", "difference_of_medians", "difference_of_means"]
GENERATOR_SEED = 20260
RESAMPLES = 10_000
AT_ONCE = 2_000_000
"""Cells of the weight table that are held in memory at a time."""

ROUNDING = 1e-6
"""Largest error of sums of weights, whose steps are larger than 1."""

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class BootstrapDifference:
    """First minus second, in the unit of the values. One cluster has no spread: no interval, no standard error."""

    statistic: Statistic
    estimate: float | None
    """None where no pair is complete."""
    low: float | None
    high: float | None
    standard_error: float | None
    """Standard deviation over the resamples."""
    n: int
    """Pairs in which both methods have a value; all others are left out."""
    n_clusters: int
    """Clusters with such a pair."""
    confidence: float
    resamples: int
    generator_seed: int


def clustered_bootstrap(
    first: Sequence[float | None],
    second: Sequence[float | None],
    *,
    clusters: Sequence[int],
    strata: Mapping[int, Hashable] | None = None,
    statistic: Statistic = "median_difference",
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    generator_seed: int = GENERATOR_SEED,
) -> BootstrapDifference:
    """Percentile interval of a paired difference when whole clusters are drawn with replacement.

    Efron & Tibshirani, An Introduction to the Bootstrap (1993), ch. 13; clusters as in Davison & Hinkley, Bootstrap
    Methods (1997), 3.8. Percentile and not BCa, because the jackknife that BCa needs is inconsistent for medians. With
    few clusters (below about 10) such intervals are too narrow. Where the quantiles of a small sample leave the
    estimate out, the interval is stretched to it. Pass 0 and 1 and ``difference_of_means`` for rates.

    Args:
        first: (N,) values of the first method, None where NA.
        second: (N,) of the second, pair by pair.
        clusters: (N,) the seed of each pair.
        strata: cluster -> stratum, to draw as ``stratified_weights`` does; None: as many clusters as there are.
        statistic: ``median_difference`` is the median of the pairs' differences, the others compare the two samples.

    Raises ValueError for lengths that differ, NaN, infinity, a cluster without a stratum, resamples < 1 or unless 0 <
    confidence < 1.
    """
    if len(clusters) != len(first):
        raise ValueError(f"{len(clusters)} clusters for {len(first)} pairs; expected one for each")
    if resamples < 1:
        raise ValueError(f"resamples = {resamples}; expected at least 1")
    check_level("confidence", confidence)
    a_kept, b_kept, kept = complete_pairs(first, second)
    a, b = np.array(a_kept, np.float64), np.array(b_kept, np.float64)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a value is infinite; expected finite values")
    of_pair: Counts
    names, of_pair = np.unique(np.array([clusters[i] for i in kept], np.int64), return_inverse=True)
    n_clusters = len(names)
    estimate = low = high = spread = None
    if len(a):
        estimate = float(_statistic(a, b, of_pair, np.ones((1, n_clusters), np.int64), statistic)[0])
    if estimate is not None and n_clusters > 1:
        drawn = (
            _draw(n_clusters, resamples, generator_seed)
            if strata is None
            else stratified_weights(
                strata_of(names.tolist(), strata), resamples=resamples, generator_seed=generator_seed
            )
        )
        found = _statistics(a, b, of_pair, drawn, statistic)
        quantiles = np.quantile(found, [0.5 - confidence / 2, 0.5 + confidence / 2])
        low, high = min(float(quantiles[0]), estimate), max(float(quantiles[1]), estimate)
        spread = float(found.std())
    return BootstrapDifference(
        statistic=statistic,
        estimate=estimate,
        low=low,
        high=high,
        standard_error=spread,
        n=len(a),
        n_clusters=n_clusters,
        confidence=confidence,
        resamples=resamples,
        generator_seed=generator_seed,
    )


def _draw(n_clusters: int, resamples: int, generator_seed: int) -> Counts:
    """(R, K) how often each cluster is in each resample."""
    generator = np.random.default_rng(generator_seed)
    return generator.multinomial(n_clusters, np.full(n_clusters, 1.0 / n_clusters), size=resamples)


def _statistics(a: Floats, b: Floats, of_pair: Counts, drawn: Counts | Floats, statistic: Statistic) -> Floats:
    """(R,) the statistic of every resample, computed for as many at a time as AT_ONCE allows."""
    step = max(1, AT_ONCE // len(a))
    return np.concatenate(
        [_statistic(a, b, of_pair, drawn[i : i + step], statistic) for i in range(0, len(drawn), step)]
    )


def _statistic(a: Floats, b: Floats, of_pair: Counts, times: Counts | Floats, statistic: Statistic) -> Floats:
    """(R,) the statistic of R resamples, in which cluster k is ``times[:, k]`` times."""
    match statistic:
        case "median_difference":
            return _medians(a - b, of_pair, times)
        case "difference_of_medians":
            return _medians(a, of_pair, times) - _medians(b, of_pair, times)
        case "difference_of_means":
            size = np.bincount(of_pair, minlength=times.shape[1])
            total = np.bincount(of_pair, weights=a - b, minlength=times.shape[1])
            return (times @ total) / (times @ size)


def _medians(values: Floats, of_pair: Counts, times: Counts | Floats) -> Floats:
    """(R,) medians of R resamples, found in the cumulated counts instead of in copies of the drawn values."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    reached = np.cumsum(times[:, of_pair[order]], axis=1)
    half = reached[:, -1:] / 2
    lower = ordered[np.argmax(reached > half - ROUNDING, axis=1)]
    upper = ordered[np.argmax(reached > half + ROUNDING, axis=1)]
    return (lower + upper) / 2
