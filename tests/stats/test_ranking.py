from __future__ import annotations

from math import nan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau

from carecontact.stats import kendall_tau, ranking_sweep

PAIRS = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=12)


def test_by_hand() -> None:
    """Of six pairs five agree and one does not."""
    assert kendall_tau([1, 2, 3, 4], [1, 2, 4, 3]).tau == pytest.approx(4 / 6)


def test_ties_by_hand() -> None:
    """Pairs (1,2), (1,3), (2,3): the first is tied on one side, the others agree; tau-b = 2 / sqrt(2 * 3)."""
    assert kendall_tau([1, 1, 2], [1, 2, 3]).tau == pytest.approx(2 / 6**0.5)


@given(pairs=PAIRS)
def test_agrees_with_scipy(pairs: list[tuple[int, int]]) -> None:
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


def test_refuses() -> None:
    with pytest.raises(ValueError, match="a level of the sweep: x"):
        ranking_sweep({"x": {"a": 1.0}}, reference="y")
    with pytest.raises(ValueError, match="expected the methods"):
        ranking_sweep({"x": {"a": 1.0}, "y": {"b": 1.0}}, reference="x")
    with pytest.raises(ValueError, match="NaN"):
        kendall_tau([nan, 1.0], [1.0, 2.0])
