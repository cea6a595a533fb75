from __future__ import annotations

from math import inf, nan
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau, wilcoxon

from carecontact.stats import (
    kendall_tau,
    mann_whitney,
    ranking_sweep,
    signed_rank,
    worst_rank_paired,
    worst_rank_unpaired,
)

PAIRS = st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), max_size=30)


def test_against_counting_by_hand() -> None:
    """Differences 1, 2, 3, -4 against all 16 signings; the equal pair and the one without a value are left out."""
    found = signed_rank([1.0, 2.0, 3.0, 0.0, 7.0, None], [0.0, 0.0, 0.0, 4.0, 7.0, 1.0])
    assert (found.rank_sum_first, found.rank_sum_second) == (6.0, 4.0)
    assert (found.n, found.n_unequal) == (5, 4)
    sums = [sum(r for r in (1, 2, 3, 4) if signs >> r & 1) for signs in range(0, 32, 2)]
    assert found.pvalue == pytest.approx(2 * sum(s <= 4 for s in sums) / 16)


def test_all_of_one_sign() -> None:
    assert signed_rank([1.0, 2.0, 3.0, 4.0, 5.0], [0.0] * 5).pvalue == pytest.approx(2 / 32)


def test_agrees_with_scipy() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=45), rng.normal(0.3, size=45)
    assert signed_rank(list(a), list(b)).pvalue == pytest.approx(wilcoxon(a, b, method="exact").pvalue)


def test_exact_with_ties() -> None:
    """All 2^9 signings of tied ranks, listed."""
    differences = [1.0, -1.0, 1.0, 2.0, 2.0, -3.0, 5.0, 5.0, 5.0]
    ranks = [2.0, 2.0, 2.0, 4.5, 4.5, 6.0, 8.0, 8.0, 8.0]
    sums = [sum(r for k, r in enumerate(ranks) if signs >> k & 1) for signs in range(512)]
    found = signed_rank(differences, [0.0] * 9)
    assert found.rank_sum_second == 8.0
    assert found.pvalue == pytest.approx(2 * sum(s <= 8.0 for s in sums) / 512)


def test_exact_meets_the_approximation(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    a, b = list(np.round(rng.normal(0.05, 1, size=300), 1)), [0.0] * 300
    exact = signed_rank(a, b).pvalue
    monkeypatch.setattr("carecontact.stats.ranks.EXACT_UP_TO", 10)
    approximate = signed_rank(a, b).pvalue
    assert 0.001 < exact < 0.1
    assert approximate == pytest.approx(exact, rel=0.02)
    assert approximate != exact


@given(pairs=PAIRS)
def test_symmetric_and_a_probability(pairs: list[tuple[int, int]]) -> None:
    a, b = [float(x) for x, _ in pairs], [float(y) for _, y in pairs]
    found, swapped, turned = signed_rank(a, b), signed_rank(b, a), signed_rank(a[::-1], b[::-1])
    assert (found.rank_sum_first, found.rank_sum_second) == (swapped.rank_sum_second, swapped.rank_sum_first)
    assert found.rank_sum_first + found.rank_sum_second == found.n_unequal * (found.n_unequal + 1) / 2
    if found.pvalue is None:
        assert not pairs
    else:
        assert 0 <= found.pvalue <= 1
        assert found.pvalue == pytest.approx(swapped.pvalue) == pytest.approx(turned.pvalue)


def test_equal_pairs_and_none_at_all() -> None:
    assert signed_rank([1.0, 2.0], [1.0, 2.0]).pvalue == 1.0
    assert signed_rank([None], [2.0]).pvalue is None


def test_infinities_are_ranks() -> None:
    found = signed_rank([inf, inf, 1.0], [1.0, inf, 2.0])
    assert (found.rank_sum_first, found.rank_sum_second, found.n_unequal) == (2.0, 1.0, 2)


@pytest.mark.parametrize(("first", "second"), [([nan], [1.0]), ([1.0], [])])
def test_refuses(first: list[Any], second: list[Any]) -> None:
    with pytest.raises(ValueError, match=r"NaN|pairs"):
        signed_rank(first, second)


VALUES = st.lists(st.tuples(*[st.one_of(st.none(), st.integers(0, 9).map(float))] * 2), max_size=20)


def test_no_score_loses_to_every_score() -> None:
    """The first presses harder where both touch, but the second touches in two of eight only."""
    first = [9.0, 9.5, 8.0, 7.0, 9.0, 8.5, 7.5, 6.0]
    second = [1.0, None, None, None, 2.0, None, None, None]
    assert signed_rank(first, second).n == 2
    found = worst_rank_paired(first, second, better="lower")
    assert (found.better, found.n_only_first, found.n_only_second, found.n) == ("first", 6, 0, 8)
    # Ranks 1 and 2 (8 and 7 newtons) against six tied at 5.5: 4 of 128 halves have a smaller sum at most 3 + 0.
    assert found.pvalue == pytest.approx(2 * 4 / 256)


def test_largest_difference_whatever_the_scores() -> None:
    found = worst_rank_paired([5.0, None, 1.0], [500.0, 900.0, 2.0], better="lower")
    assert found.better == "neither", "ranks 1 and 2 for the first, 3 for the second"


@pytest.mark.parametrize(("better", "side"), [("higher", "first"), ("lower", "second")])
def test_direction(better: Literal["higher", "lower"], side: str) -> None:
    assert worst_rank_paired([2.0, 3.0], [1.0, 1.0], better=better).better == side
    assert worst_rank_paired([None, 3.0], [None, None], better=better).better == "first"


@given(pairs=VALUES, better=st.sampled_from(["higher", "lower"]))
def test_symmetric(pairs: Any, better: Any) -> None:
    a, b = [x for x, _ in pairs], [y for _, y in pairs]
    found, swapped = worst_rank_paired(a, b, better=better), worst_rank_paired(b, a, better=better)
    other = {"first": "second", "second": "first", "neither": "neither"}
    assert swapped.better == other[found.better]
    assert (found.n_only_first, found.n_only_second) == (swapped.n_only_second, swapped.n_only_first)
    assert found.pvalue == pytest.approx(swapped.pvalue)
    if None not in a + b:
        assert found.pvalue == signed_rank(a, b).pvalue


def test_unpaired() -> None:
    found = worst_rank_unpaired([1.0, None, None], [3.0, 4.0, 5.0], better="higher")
    assert found == mann_whitney([1.0, 0.0, 0.0], [3.0, 4.0, 5.0])
    assert worst_rank_unpaired([1.0, None], [2.0, 3.0], better="lower").statistic == 2.0


@pytest.mark.parametrize("compare", [worst_rank_paired, worst_rank_unpaired])
def test_refuses_nan(compare: Any) -> None:
    with pytest.raises(ValueError, match="NaN"):
        compare([nan], [1.0], better="lower")


RANKING_PAIRS = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=12)


def test_by_hand() -> None:
    """Of six pairs five agree and one does not."""
    assert kendall_tau([1, 2, 3, 4], [1, 2, 4, 3]).tau == pytest.approx(4 / 6)


def test_ties_by_hand() -> None:
    """Pairs (1,2), (1,3), (2,3): the first is tied on one side, the others agree; tau-b = 2 / sqrt(2 * 3)."""
    assert kendall_tau([1, 1, 2], [1, 2, 3]).tau == pytest.approx(2 / 6**0.5)


@given(pairs=RANKING_PAIRS)
def test_the_ranking_agrees_with_scipy(pairs: list[tuple[int, int]]) -> None:
    a, b = [x for x, _ in pairs], [y for _, y in pairs]
    found = kendall_tau([*a, None], [*b, 3])
    assert found.n == len(pairs)
    if len(set(a)) < 2 or len(set(b)) < 2:
        assert (found.tau, found.pvalue) == (None, None)
        return
    expected = kendalltau(a, b)
    assert (found.tau, found.pvalue) == (pytest.approx(expected.statistic), pytest.approx(expected.pvalue))
    assert found.tau == pytest.approx(kendall_tau([*b, 3], [*a, None]).tau)


def test_a_sweep_says_where_the_ranking_turns() -> None:
    sweep = {
        "0.20": {"a": 49.0, "b": 39.0, "c": 0.0, "d": 50.0},
        "0.35": {"a": 79.0, "b": 39.0, "c": 0.0, "d": 80.0},
        "1.00": {"a": 101.0, "b": 39.0, "c": 120.0, "d": None},
    }
    found = ranking_sweep(sweep, reference="0.35")
    assert [found.tau[level].tau for level in sweep] == [pytest.approx(1), pytest.approx(1), pytest.approx(-1 / 3)]
    assert found.tau["1.00"].n == 3
    assert found.least == pytest.approx(-1 / 3)


def test_no_order_no_tau() -> None:
    found = ranking_sweep({"x": {"a": 1.0, "b": 1.0}}, reference="x")
    assert found.tau["x"].tau is None
    assert found.least is None


def test_ranking_refuses() -> None:
    with pytest.raises(ValueError, match="a level of the sweep: x"):
        ranking_sweep({"x": {"a": 1.0}}, reference="y")
    with pytest.raises(ValueError, match="expected the methods"):
        ranking_sweep({"x": {"a": 1.0}, "y": {"b": 1.0}}, reference="x")
    with pytest.raises(ValueError, match="NaN"):
        kendall_tau([nan, 1.0], [1.0, 2.0])
