from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from carecontact.stats import mcnemar_exact

COUNT = st.integers(0, 80)


@pytest.mark.parametrize(
    ("only_first", "only_second", "pvalue"),
    [(0, 0, 1.0), (1, 0, 1.0), (5, 0, 2 / 32), (6, 0, 2 / 64), (3, 3, 1.0), (1, 5, 2 * 7 / 64), (2, 5, 2 * 29 / 128)],
)
def test_against_counting_by_hand(only_first: int, only_second: int, pvalue: float) -> None:
    assert mcnemar_exact(only_first, only_second).pvalue == pytest.approx(pvalue)


def test_gives_the_published_value() -> None:
    """Two culture media on fifty specimens (Armitage & Berry 1994, p. 127)."""
    assert f"{mcnemar_exact(12, 2).pvalue:.4f}" == "0.0129"


@given(only_first=COUNT, only_second=COUNT)
def test_is_the_sign_test_and_symmetric(only_first: int, only_second: int) -> None:
    found, swapped = mcnemar_exact(only_first, only_second), mcnemar_exact(only_second, only_first)
    assert 0 <= found.pvalue <= 1
    assert found.pvalue == pytest.approx(swapped.pvalue)
    assert (found.only_first, found.only_second) == (only_first, only_second)
    if only_first + only_second:
        assert found.pvalue == pytest.approx(binomtest(only_second, only_first + only_second).pvalue)


@pytest.mark.parametrize("counts", [(3, -1), (1.5, 3), (True, 3), ("2", 3)])
def test_refuses_what_is_no_count(counts: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"discordant pairs = .*; expected a whole number from 0 up"):
        mcnemar_exact(*counts)
