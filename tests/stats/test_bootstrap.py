from __future__ import annotations

import itertools
import statistics
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.stats import clustered_bootstrap
from carecontact.stats.bootstrap import Statistic

STATISTICS: tuple[Statistic, ...] = ("median_difference", "difference_of_medians", "difference_of_means")
VALUE = st.one_of(st.none(), st.floats(-50, 50, width=32))
PAIRS = st.lists(st.tuples(VALUE, VALUE, st.integers(0, 5)), max_size=25)
FEW: dict[str, Any] = {"resamples": 60}


def found(pairs: list[tuple[Any, Any, int]], **options: Any) -> Any:
    return clustered_bootstrap(
        [a for a, _, _ in pairs], [b for _, b, _ in pairs], clusters=[c for _, _, c in pairs], **options
    )


def test_estimates_by_hand() -> None:
    pairs = [(1.0, 0.0, 0), (5.0, 3.0, 1), (6.0, 12.0, 2), (None, 3.0, 0), (2.0, None, 4)]
    assert found(pairs, statistic="median_difference").estimate == 1.0
    assert found(pairs, statistic="difference_of_medians").estimate == 2.0
    assert found(pairs, statistic="difference_of_means").estimate == -1.0
    assert (found(pairs).n, found(pairs).n_clusters) == (3, 3)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_against_every_resample(statistic: Statistic) -> None:
    """Four clusters of unequal size have 256 equally likely resamples, which Python can list."""
    clusters = {0: [(1.0, 4.0)], 1: [(2.5, 2.0), (8.0, 1.0)], 2: [(3.0, 3.5), (0.0, 6.0), (9.0, 9.5)], 3: [(7.0, 0.0)]}
    of: dict[Statistic, Any] = {
        "median_difference": lambda rows: statistics.median(a - b for a, b in rows),
        "difference_of_medians": lambda r: statistics.median(a for a, _ in r) - statistics.median(b for _, b in r),
        "difference_of_means": lambda rows: statistics.mean(a - b for a, b in rows),
    }
    every = [
        of[statistic]([row for k in drawn for row in clusters[k]]) for drawn in itertools.product(clusters, repeat=4)
    ]
    pairs = [(a, b, k) for k, rows in clusters.items() for a, b in rows]
    result = found(pairs, statistic=statistic, confidence=0.6, resamples=40_000)
    # The statistic has few values, so that a quantile jumps: it is held between its neighbours.
    assert np.quantile(every, 0.18) <= result.low <= np.quantile(every, 0.22)
    assert np.quantile(every, 0.78) <= result.high <= np.quantile(every, 0.82)
    assert result.standard_error == pytest.approx(np.std(every), rel=0.02)


def test_clusters_that_agree_within_widen_the_interval() -> None:
    rng = np.random.default_rng(5)
    shift = rng.normal(size=20)
    pairs = [(float(shift[i % 20] + 0.1 * rng.normal()), 0.0, i % 20) for i in range(140)]
    clustered = found(pairs, statistic="difference_of_means")
    apart = found([(a, b, i) for i, (a, b, _) in enumerate(pairs)], statistic="difference_of_means")
    assert clustered.high - clustered.low > 2 * (apart.high - apart.low)


def test_covers() -> None:
    """300 runs of 20 seeds and 4 tasks with a seed's share in common: about 95 in 100 intervals hold the truth, and
    far fewer where the seeds are taken for independent trials."""
    rng = np.random.default_rng(7)
    clusters = np.repeat(np.arange(20), 4)
    clustered = apart = 0
    for _ in range(300):
        d = 1.0 + np.repeat(rng.normal(size=20), 4) + 0.5 * rng.normal(size=80)
        for ids, is_clustered in ((clusters, True), (np.arange(80), False)):
            result = clustered_bootstrap(
                list(d), [0.0] * 80, clusters=ids.tolist(), statistic="difference_of_means", resamples=400
            )
            assert result.low is not None
            assert result.high is not None
            held = result.low <= 1.0 <= result.high
            clustered, apart = clustered + (held and is_clustered), apart + (held and not is_clustered)
    assert 0.89 < clustered / 300 < 0.98
    assert apart / 300 < 0.80


@settings(deadline=None)
@given(pairs=PAIRS, statistic=st.sampled_from(STATISTICS), shuffle=st.randoms(use_true_random=False))
def test_holds_the_estimate_mirrors_and_ignores_order(pairs: Any, statistic: Statistic, shuffle: Any) -> None:
    result = found(pairs, statistic=statistic, **FEW)
    mirror = found([(b, a, c) for a, b, c in pairs], statistic=statistic, **FEW)
    mixed = list(pairs)
    shuffle.shuffle(mixed)
    again = found(mixed, statistic=statistic, **FEW)
    assert (result.n, result.n_clusters) == (again.n, again.n_clusters) == (mirror.n, mirror.n_clusters)
    if result.estimate is None:
        assert result.n == 0
        return
    assert again.estimate == pytest.approx(result.estimate, abs=1e-6)
    assert mirror.estimate == pytest.approx(-result.estimate, abs=1e-6)
    if result.n_clusters == 1:
        assert (result.low, result.high, result.standard_error) == (None, None, None)
        return
    assert result.low <= result.estimate <= result.high
    assert (again.low, again.high) == pytest.approx((result.low, result.high), abs=1e-6)
    assert (mirror.low, mirror.high) == pytest.approx((-result.high, -result.low), abs=1e-6)


def test_narrow_intervals_are_stretched_to_the_estimate() -> None:
    """The middle hundredth of a skewed distribution lies on one side of the estimate."""
    pairs = [(value, 0.0, k) for k, value in enumerate((0.0, 1.0, 2.0, 4.0, 60.0))]
    right = found(pairs, statistic="difference_of_means", confidence=0.01)
    left = found([(b, a, k) for a, b, k in pairs], statistic="difference_of_means", confidence=0.01)
    assert right.low < right.high == right.estimate == 13.4
    assert left.high > left.low == left.estimate == -13.4


def test_the_same_numbers_every_time_whatever_is_held_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = [(float(i * i % 17), float(i % 5), i % 6) for i in range(30)]
    first = found(pairs)
    monkeypatch.setattr("carecontact.stats.bootstrap.AT_ONCE", 1000)
    assert found(pairs) == first
    assert found(pairs, generator_seed=1) != first


@pytest.mark.parametrize(
    ("pairs", "options", "told"),
    [
        ([(nan, 1.0, 0)], {}, "NaN"),
        ([(inf, 1.0, 0)], {}, "infinite"),
        ([(0.0, 1.0, 0)], {"confidence": 0.0}, "confidence"),
        ([(0.0, 1.0, 0)], {"resamples": 0}, "resamples"),
    ],
)
def test_refuses(pairs: Any, options: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        found(pairs, **options)


def test_refuses_lengths_that_differ() -> None:
    with pytest.raises(ValueError, match="clusters"):
        clustered_bootstrap([1.0], [1.0], clusters=[])
    with pytest.raises(ValueError, match="pairs"):
        clustered_bootstrap([1.0], [], clusters=[0])
