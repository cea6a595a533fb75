from __future__ import annotations

import math
from math import nan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from carecontact.stats import fisher_exact, holm, mann_whitney, median, wilson_interval


@pytest.mark.parametrize(
    ("k", "low", "high"), [(102, 65.0, 79.5), (79, 48.2, 64.4), (39, 21.1, 35.8), (1, 0.1, 3.9), (0, 0.0, 2.7)]
)
def test_wilson_gives_the_published_intervals(k: int, low: float, high: float) -> None:
    found = wilson_interval(k, 140)
    assert (round(100 * found.low, 1), round(100 * found.high, 1)) == (low, high)
    assert found.estimate == k / 140


@pytest.mark.parametrize(("k1", "k2", "pvalue"), [(102, 39, "4.74e-14"), (79, 39, "1.99e-06")])
def test_fisher_gives_the_published_values(k1: int, k2: int, pvalue: str) -> None:
    assert f"{fisher_exact(k1, 140, k2, 140).pvalue:.2e}" == pvalue


@given(n=st.integers(1, 500), share=st.floats(0, 1), confidence=st.floats(0.5, 0.999))
def test_wilson_holds_the_estimate_and_mirrors(n: int, share: float, confidence: float) -> None:
    k = round(share * n)
    found, mirror = wilson_interval(k, n, confidence), wilson_interval(n - k, n, confidence)
    assert 0 <= found.low <= found.estimate <= found.high <= 1
    assert found.low == pytest.approx(1 - mirror.high, abs=1e-12)
    wider = wilson_interval(k, n, (1 + confidence) / 2)
    assert wider.low <= found.low
    assert wider.high >= found.high


def test_wilson_solves_its_equation() -> None:
    """The bounds are where the score statistic equals the normal quantile."""
    found = wilson_interval(7, 20)
    for bound in (found.low, found.high):
        assert abs(7 / 20 - bound) / math.sqrt(bound * (1 - bound) / 20) == pytest.approx(1.959964, abs=1e-5)


def test_wilson_of_nothing() -> None:
    found = wilson_interval(0, 0)
    assert (found.estimate, found.low, found.high) == (None, 0.0, 1.0)


@pytest.mark.parametrize("arguments", [(-1, 5), (6, 5), (1.5, 3), (1, 3.0), (1, 5, 0.0), (1, 5, 1.0)])
def test_wilson_refuses(arguments: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="expected"):
        wilson_interval(*arguments)


def test_fisher_against_counting_by_hand() -> None:
    """3 of 4 against 1 of 4: tables at most as likely are 1 + 16 + 16 + 1 of the 70."""
    found = fisher_exact(3, 4, 1, 4)
    assert found.pvalue == pytest.approx(34 / 70)
    assert found.odds_ratio == pytest.approx(9.0)
    assert fisher_exact(4, 4, 2, 4).odds_ratio == math.inf
    for wrong in ((5, 4, 1, 4), (1, 4, 1.5, 4), (1, 4.0, 1, 4)):
        with pytest.raises(ValueError, match="expected"):
            fisher_exact(*wrong)  # type: ignore[arg-type]


def test_mann_whitney_against_counting_by_hand() -> None:
    """All of three below all of three: 2 of 20 orderings are as extreme."""
    found = mann_whitney([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    assert found.statistic == 0
    assert found.pvalue == pytest.approx(0.1)
    with pytest.raises(ValueError, match="at least one"):
        mann_whitney([], [1.0])
    with pytest.raises(ValueError, match="NaN"):
        mann_whitney([1.0], [math.nan])


def test_contrasts_agree_with_scipy() -> None:
    first, second = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0], [2.0, 6.0, 5.0, 3.0, 5.0]
    assert mann_whitney(first, second).pvalue == scipy_stats.mannwhitneyu(first, second).pvalue
    assert fisher_exact(7, 20, 13, 18).pvalue == scipy_stats.fisher_exact([[7, 13], [13, 5]]).pvalue
    expected = scipy_stats.binomtest(7, 20).proportion_ci(method="wilson")
    assert (wilson_interval(7, 20).low, wilson_interval(7, 20).high) == pytest.approx((expected.low, expected.high))


def test_median_counts_what_it_rests_on() -> None:
    found = median([3.0, None, 1.0, 2.0, None, 10.0])
    assert (found.estimate, found.n_valid, found.n) == (2.5, 4, 6)
    assert median([None, None]).estimate is None
    with pytest.raises(ValueError, match="NaN"):
        median([1.0, math.nan])


PVALUES = st.lists(st.one_of(st.none(), st.floats(0, 1)), max_size=12)


def test_by_hand() -> None:
    """Sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1 is 0.02, 0.03, 0.06, 0.04, and none may fall."""
    found = holm([0.01, 0.04, None, 0.03, 0.005])
    assert found.adjusted == pytest.approx((0.03, 0.06, None, 0.06, 0.02))
    assert found.n == 4


def test_nothing_exceeds_one() -> None:
    assert holm([0.6, 0.9]).adjusted == (1.0, 1.0)
    assert holm([]).adjusted == ()


@given(pvalues=PVALUES)
def test_between_the_single_test_and_bonferroni(pvalues: list[float | None]) -> None:
    found = holm(pvalues)
    for p, adjusted in zip(pvalues, found.adjusted, strict=True):
        assert (p is None) == (adjusted is None)
        if p is not None and adjusted is not None:
            assert p <= adjusted <= min(1.0, found.n * p)
    assert holm(pvalues[::-1]).adjusted == found.adjusted[::-1]


@pytest.mark.parametrize("p", [-0.1, 1.1, nan])
def test_refuses(p: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        holm([0.5, p])
