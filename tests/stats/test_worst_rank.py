from __future__ import annotations

from math import nan
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.stats import mann_whitney, signed_rank, worst_rank_paired, worst_rank_unpaired

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
