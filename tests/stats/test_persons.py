from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.stats import (
    mcnemar_exact,
    person_difference,
    person_rate,
    sign_flip,
    stratified_weights,
    wilson_interval,
    worst_share,
)


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


def test_a_task_that_all_fail_makes_nobody_worse_off() -> None:
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
