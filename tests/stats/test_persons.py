from __future__ import annotations

import itertools
import statistics
from itertools import product
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.stats import (
    clustered_bootstrap,
    mcnemar_exact,
    person_difference,
    person_rate,
    sign_flip,
    stratified_weights,
    wilson_interval,
    worst_share,
)
from carecontact.stats.persons import Statistic


def test_weights_keep_the_size_of_every_stratum() -> None:
    strata = [*"aaabbbbb", "c", "d"]
    weights = stratified_weights(strata, resamples=200)
    assert np.allclose(weights[:, :3].sum(axis=1), 3)
    assert np.allclose(weights[:, 3:8].sum(axis=1), 5)
    assert np.allclose(weights[:, 8:].sum(axis=1), 2), "strata of one are taken together"
    assert np.allclose(stratified_weights([*"aab"], resamples=9).sum(axis=1), 3), "a last one joins the largest"
    assert np.allclose(stratified_weights([*"ab"], resamples=9).sum(axis=1), 2)


@pytest.mark.parametrize("sizes", [(2, 3), (3, 3, 3), (9,)])
def test_the_variance_of_a_mean_is_the_unbiased_one(sizes: tuple[int, ...]) -> None:
    """Of a stratified sample: the sum over strata of n s^2, over the squared number of persons (Cochran, 5.4)."""
    generator = np.random.default_rng(1)
    strata = [h for h, n in enumerate(sizes) for _ in range(n)]
    values = generator.normal(size=len(strata)) + 5 * np.array(strata)
    means = stratified_weights(strata, resamples=60_000) @ values / len(strata)
    exact = sum(n * values[np.array(strata) == h].var(ddof=1) for h, n in enumerate(sizes)) / len(strata) ** 2
    assert means.var() == pytest.approx(exact, rel=0.03)
    assert means.mean() == pytest.approx(values.mean(), abs=0.01)


def test_strata_take_out_what_bodies_do() -> None:
    """Of three bodies, one always fails: with the body fixed, that is no uncertainty."""
    persons = [p for p in range(9) for _ in range(7)]
    passed = [p % 3 > 0 and (p + t) % 5 > 0 for p in range(9) for t in range(7)]
    fixed = person_rate(passed, persons=persons, strata={p: p % 3 for p in range(9)})
    free = person_rate(passed, persons=persons)
    assert fixed.estimate == free.estimate == sum(passed) / 63
    assert fixed.high - fixed.low < 0.3 * (free.high - free.low)


def test_trials_of_one_person_are_no_independent_trials() -> None:
    """Persons that pass everything or nothing: the interval is that of persons, and not of trials."""
    persons = [p for p in range(20) for _ in range(7)]
    found = person_rate([p < 14 for p in persons], persons=persons)
    of_persons, of_trials = wilson_interval(14, 20), wilson_interval(98, 140)
    assert found.low == pytest.approx(of_persons.low, abs=0.06)
    assert found.high == pytest.approx(of_persons.high, abs=0.06)
    assert found.high - found.low > 2 * (of_trials.high - of_trials.low)


@pytest.mark.parametrize("passes", [True, False])
def test_where_all_are_alike_the_interval_is_that_of_so_many_persons(passes: bool) -> None:
    persons = [p for p in range(9) for _ in range(7)]
    found, wilson = person_rate([passes] * 63, persons=persons), wilson_interval(9 * passes, 9)
    assert (found.low, found.high) == (wilson.low, wilson.high)
    one = person_rate([True, False], persons=[4, 4])
    assert (one.estimate, one.persons) == (0.5, 1)
    assert (one.low, one.high) == (0.0, 1.0)
    none = person_rate([], persons=[])
    assert (none.estimate, none.low, none.high) == (None, 0.0, 1.0)


def test_the_interval_covers_as_often_as_it_says() -> None:
    """400 samples of 18 persons of unequal rates; a normal interval of 18 clusters covers a little too seldom."""
    generator = np.random.default_rng(3)
    strata = {p: p % 6 for p in range(18)}
    persons = np.repeat(np.arange(18), 7)
    covered = 0
    for _ in range(400):
        rates = np.clip(0.3 + 0.08 * np.arange(6)[np.arange(18) % 6] + generator.normal(0, 0.1, 18), 0, 1)
        passed = generator.random(126) < rates[persons]
        found = person_rate(passed.tolist(), persons=persons.tolist(), strata=strata, resamples=400)
        covered += found.low <= 0.5 <= found.high
    assert 0.90 < covered / 400 < 0.98


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(-7, 7), min_size=1, max_size=9))
def test_the_flip_test_is_the_enumeration_of_all_signs(differences: list[int]) -> None:
    sums = [
        sum(s * abs(d) for s, d in zip(signs, differences, strict=True))
        for signs in product((-1, 1), repeat=len(differences))
    ]
    expected = np.mean([abs(s) >= abs(sum(differences)) for s in sums])
    assert sign_flip(differences).pvalue == pytest.approx(expected)


@pytest.mark.parametrize(("only_first", "only_second"), [(0, 6), (9, 2), (5, 5), (1, 0)])
def test_with_one_trial_a_person_it_is_mcnemars_test(only_first: int, only_second: int) -> None:
    found = sign_flip([1] * only_first + [-1] * only_second + [0] * 4)
    assert found.pvalue == pytest.approx(mcnemar_exact(only_first, only_second).pvalue)
    assert (found.n, found.n_unequal) == (only_first + only_second + 4, only_first + only_second)


def test_a_flip_test_of_nothing() -> None:
    assert sign_flip([]).pvalue is None
    assert sign_flip([0, 0]).pvalue == 1.0
    with pytest.raises(ValueError, match="no whole number"):
        sign_flip([0.5])  # type: ignore[list-item]


def test_a_difference_over_persons_sees_the_pairs() -> None:
    """One method passes one trial more on every person but one, however the persons differ."""
    persons = [p for p in range(10) for _ in range(7)]
    second = [t < p % 6 for p in range(10) for t in range(7)]
    first = [t < p % 6 + (p > 0) for p in range(10) for t in range(7)]
    found = person_difference(first, second, persons=persons)
    assert found.estimate == pytest.approx(9 / 70)
    assert found.low > 0.08
    assert found.high < 0.16
    assert found.test.pvalue == pytest.approx(2 / 2**9)
    alike = person_difference([True] * 14, [False] * 14, persons=[p for p in range(2) for _ in range(7)])
    assert 0 < alike.low < 0.5, "two persons prove little"
    assert alike.high == alike.estimate == 1.0


def test_the_worst_tenth_is_that_of_the_persons() -> None:
    """27 persons, of whom the lowest pass 0, 1 and 2 of 7: 2.7 persons have (0 + 1 + 0.7 * 2) / 7 / 2.7."""
    k = [0, 1, 2, *[6] * 24]
    persons = [p for p in range(27) for _ in range(7)]
    passed = [t < k[p] for p in range(27) for t in range(7)]
    tasks = [t for _ in range(27) for t in range(7)]
    found = worst_share(passed, persons=persons, tasks=tasks)
    assert found.estimate == pytest.approx((0 + 1 + 0.7 * 2) / 7 / 2.7)
    assert found.low <= (0 + 1 + 0.7 * 2) / 7 / 2.7 <= found.high
    few = worst_share([True, False, True], persons=[1, 2, 3], tasks=["T1"] * 3)
    assert few.estimate == 0.0


def test_bad_luck_makes_a_worst_tenth_too() -> None:
    """Coins: the lowest of 50 alike persons lie far below one half, and no further than chance."""
    generator = np.random.default_rng(2)
    persons, tasks = [p for p in range(50) for _ in range(7)], [t for _ in range(50) for t in range(7)]
    coins = worst_share((generator.random(350) < 0.5).tolist(), persons=persons, tasks=tasks)
    assert coins.by_chance is not None
    assert coins.estimate < 0.3
    assert coins.estimate == pytest.approx(coins.by_chance, abs=0.07)
    assert coins.pvalue > 0.05
    unequal = worst_share([p >= 10 for p in persons], persons=persons, tasks=tasks)
    assert unequal.estimate == 0.0
    assert unequal.by_chance > 0.3
    assert unequal.pvalue < 0.001


def test_a_task_that_all_fail_makes_no_person_worse_off() -> None:
    persons, tasks = [p for p in range(10) for _ in range(4)], [t for _ in range(10) for t in range(4)]
    found = worst_share([t > 0 for t in tasks], persons=persons, tasks=tasks)
    assert found.estimate == found.by_chance == 0.75
    assert found.pvalue == 1.0


def test_lengths_and_strata_are_checked() -> None:
    with pytest.raises(ValueError, match="1 persons for 2 trials"):
        person_rate([True, False], persons=[1])
    with pytest.raises(ValueError, match="person 2 has no stratum"):
        person_rate([True, False], persons=[1, 2], strata={1: 0})
    with pytest.raises(ValueError, match="expected as many of each"):
        worst_share([True], persons=[1], tasks=[])
    with pytest.raises(ValueError, match="expected at least 2"):
        stratified_weights([0])


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
    monkeypatch.setattr("carecontact.stats.persons.AT_ONCE", 1000)
    assert found(pairs) == first
    monkeypatch.setattr("carecontact.stats.persons.GENERATOR_SEED", 1)
    assert found(pairs).standard_error != first.standard_error


@pytest.mark.parametrize(
    ("pairs", "options", "message"),
    [
        ([(nan, 1.0, 0)], {}, "NaN"),
        ([(inf, 1.0, 0)], {}, "infinite"),
        ([(0.0, 1.0, 0)], {"confidence": 0.0}, "confidence"),
        ([(0.0, 1.0, 0)], {"resamples": 0}, "resamples"),
    ],
)
def test_refuses(pairs: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        found(pairs, **options)


def test_refuses_lengths_that_differ() -> None:
    with pytest.raises(ValueError, match="clusters"):
        clustered_bootstrap([1.0], [1.0], clusters=[])
    with pytest.raises(ValueError, match="pairs"):
        clustered_bootstrap([1.0], [], clusters=[0])
