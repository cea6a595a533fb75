from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.stats import paired_difference, unpaired_difference, wilson_interval

COUNT = st.integers(0, 60)


@pytest.mark.parametrize(
    ("counts", "low", "high"),
    [
        ((36, 12, 2, 0), "0.0569", "0.3404"),  # Newcombe 1998, Table II
        ((1, 1, 7, 12), "-0.5069", "-0.0256"),  # Fagerland, Lydersen & Laake 2014: -0.507 to -0.026
    ],
)
def test_paired_gives_the_published_intervals(counts: tuple[int, int, int, int], low: str, high: str) -> None:
    both, only_first, only_second, neither = counts
    found = paired_difference(both=both, only_first=only_first, only_second=only_second, neither=neither)
    assert (f"{found.low:.4f}", f"{found.high:.4f}") == (low, high)


def test_unpaired_gives_the_published_interval() -> None:
    """56 of 70 against 48 of 80 (Newcombe 1998, method 10)."""
    found = unpaired_difference(56, 70, 48, 80)
    assert (f"{found.low:.4f}", f"{found.high:.4f}") == ("0.0524", "0.3339")


def test_pairs_in_agreement_narrow_the_interval() -> None:
    paired = paired_difference(both=70, only_first=10, only_second=0, neither=60)
    unpaired = unpaired_difference(80, 140, 70, 140)
    assert paired.estimate == unpaired.estimate == pytest.approx(10 / 140)
    assert paired.high - paired.low < 0.6 * (unpaired.high - unpaired.low)
    assert paired.low > 0 > unpaired.low


def test_continuity_correction_by_hand() -> None:
    """20, 12, 2, 16: phi = (320 - 24 - 25) / sqrt(32 18 22 28), the Wilson intervals of 32 and 22 of 50."""
    first, second = wilson_interval(32, 50), wilson_interval(22, 50)
    phi = 271 / math.sqrt(32 * 18 * 22 * 28)
    a, b = 0.64 - first.low, second.high - 0.44
    found = paired_difference(both=20, only_first=12, only_second=2, neither=16)
    assert found.low == pytest.approx(0.2 - math.sqrt(a * a + b * b - 2 * phi * a * b))


@given(both=COUNT, only_first=COUNT, only_second=COUNT, neither=COUNT)
def test_paired_holds_the_estimate_and_mirrors(both: int, only_first: int, only_second: int, neither: int) -> None:
    found = paired_difference(both=both, only_first=only_first, only_second=only_second, neither=neither)
    swapped = paired_difference(both=both, only_first=only_second, only_second=only_first, neither=neither)
    assert (found.low, found.high) == pytest.approx((-swapped.high, -swapped.low), abs=1e-12)
    assert -1 <= found.low <= found.high <= 1
    if found.estimate is not None:
        assert found.low - 1e-12 <= found.estimate <= found.high + 1e-12


def test_paired_covers() -> None:
    """4,000 draws of 40 correlated pairs that differ by 0.2: about 95 in 100 intervals hold it."""
    draws = np.random.default_rng(1).multinomial(40, [0.4, 0.25, 0.05, 0.3], size=4000)
    counts, times = np.unique(draws, axis=0, return_counts=True)
    covered = 0
    for (both, only_first, only_second, neither), k in zip(counts.tolist(), times.tolist(), strict=True):
        found = paired_difference(both=both, only_first=only_first, only_second=only_second, neither=neither)
        covered += k * (found.low <= 0.2 <= found.high)
    assert 0.935 < covered / 4000 < 0.975


def test_of_nothing() -> None:
    found = paired_difference(both=0, only_first=0, only_second=0, neither=0)
    assert (found.estimate, found.low, found.high) == (None, -1.0, 1.0)
    assert unpaired_difference(0, 0, 1, 2).estimate is None


def test_refuses() -> None:
    with pytest.raises(ValueError, match="from 0 up"):
        paired_difference(both=1, only_first=-1, only_second=0, neither=4)
    with pytest.raises(ValueError, match="confidence"):
        paired_difference(both=1, only_first=1, only_second=0, neither=4, confidence=1.0)
    with pytest.raises(ValueError, match="expected"):
        unpaired_difference(3, 2, 0, 2)
