from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import wilcoxon

from carecontact.stats import signed_rank

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
    monkeypatch.setattr("carecontact.stats.wilcoxon.EXACT_UP_TO", 10)
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
