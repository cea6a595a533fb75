from __future__ import annotations

from math import nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.stats import holm

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
