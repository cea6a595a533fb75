from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from carecontact.stats import (
    detectable_from_standard_error,
    mcnemar_exact,
    paired_detectable_difference,
    paired_difference,
    unpaired_detectable_difference,
    unpaired_difference,
    wilson_interval,
)

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


MCNEMAR_COUNT = st.integers(0, 80)


@pytest.mark.parametrize(
    ("only_first", "only_second", "pvalue"),
    [(0, 0, 1.0), (1, 0, 1.0), (5, 0, 2 / 32), (6, 0, 2 / 64), (3, 3, 1.0), (1, 5, 2 * 7 / 64), (2, 5, 2 * 29 / 128)],
)
def test_against_counting_by_hand(only_first: int, only_second: int, pvalue: float) -> None:
    assert mcnemar_exact(only_first, only_second).pvalue == pytest.approx(pvalue)


def test_gives_the_published_value() -> None:
    """Two culture media on fifty specimens (Armitage & Berry 1994, p. 127)."""
    assert f"{mcnemar_exact(12, 2).pvalue:.4f}" == "0.0129"


@given(only_first=MCNEMAR_COUNT, only_second=MCNEMAR_COUNT)
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


def test_paired_against_the_test_itself() -> None:
    """At the smallest detectable difference 80 in 100 simulated runs are significant, at half of it far fewer."""
    n, discordance = 140, 0.3
    found = paired_detectable_difference(n=n, discordance=discordance).difference
    assert found is not None
    rng = np.random.default_rng(2)
    share: list[float] = []
    for difference in (found, found / 2):
        p = [(discordance + difference) / 2, (discordance - difference) / 2, 1 - discordance]
        draws, times = np.unique(rng.multinomial(n, p, size=20_000), axis=0, return_counts=True)
        significant = [mcnemar_exact(a, b).pvalue <= 0.05 for a, b, _ in draws.tolist()]
        share.append(float(times[significant].sum() / 20_000))
    assert share[0] == pytest.approx(0.8, abs=0.01)
    assert share[1] < 0.35


def test_paired_without_discordance_needs_six_pairs() -> None:
    """P(at least 6 of 140 pairs) = 0.8 at the difference found; five pairs are never significant."""
    found = paired_detectable_difference(n=140, discordance=0.0).difference
    assert found is not None
    draws = np.random.default_rng(4).binomial(140, found, size=100_000)
    assert (draws >= 6).mean() == pytest.approx(0.8, abs=0.005)
    assert paired_detectable_difference(n=5, discordance=0.4).difference is None
    assert paired_detectable_difference(n=6, discordance=0.4).difference == pytest.approx(0.8 ** (1 / 6), abs=1e-6)
    assert paired_detectable_difference(n=0, discordance=0.0).difference is None


def test_paired_counts_both_tails() -> None:
    """Without any difference the test rejects more often than alpha / 2, in either direction."""
    assert paired_detectable_difference(n=140, discordance=0.5, power=0.027).difference == pytest.approx(0, abs=1e-6)


def test_paired_near_the_textbook_formula() -> None:
    """Connor 1987 by the normal approximation: n d^2 = (z_a sqrt(psi) + z_b sqrt(psi - d^2))^2."""
    n, psi = 2000, 0.4
    found = paired_detectable_difference(n=n, discordance=psi).difference
    normal = (1.959964 * psi**0.5 + 0.841621 * (psi - found**2) ** 0.5) / n**0.5
    assert found == pytest.approx(normal, rel=0.03)


@settings(max_examples=40, deadline=None)
@given(n=st.integers(0, 80), discordance=st.floats(0, 1), alpha=st.sampled_from([0.05, 0.01]))
def test_more_pairs_detect_more(n: int, discordance: float, alpha: float) -> None:
    less = paired_detectable_difference(n=n, discordance=discordance, alpha=alpha).difference
    more = paired_detectable_difference(n=4 * n + 4, discordance=discordance, alpha=alpha).difference
    strict = paired_detectable_difference(n=n, discordance=discordance, alpha=alpha / 7).difference
    if less is not None:
        assert 0 < less <= 1
        assert more <= less
    if strict is not None:
        assert less <= strict


def test_unpaired_near_the_textbook_value() -> None:
    """Rates 0.6 and 0.4 need 97 trials each for 80 % (Fleiss, without continuity correction)."""
    found = unpaired_detectable_difference(n1=97, n2=97, rate=0.4).difference
    assert found == pytest.approx(0.2, abs=0.001)
    assert unpaired_detectable_difference(n1=97, n2=97, rate=0.6).difference == found


def test_unpaired_edges() -> None:
    assert unpaired_detectable_difference(n1=0, n2=9, rate=0.5).difference is None
    assert unpaired_detectable_difference(n1=1, n2=1, rate=0.5).difference is None
    few, many = (unpaired_detectable_difference(n1=n, n2=n, rate=0.0).difference for n in (10, 140))
    assert 0 < many < few < 1


def test_from_standard_error() -> None:
    assert detectable_from_standard_error(1.0).difference == pytest.approx(2.801585, abs=1e-6)
    assert detectable_from_standard_error(0.0).difference == 0.0


def test_power_refuses() -> None:
    for paired in ({"n": -1, "discordance": 0.1}, {"n": 3, "discordance": 1.1}):
        with pytest.raises(ValueError, match="expected"):
            paired_detectable_difference(**paired)
    for n1, n2, rate in ((3, 3, -0.1), (3, 3, 1.1), (-1, 3, 0.1), (3, -1, 0.1)):
        with pytest.raises(ValueError, match="expected"):
            unpaired_detectable_difference(n1=n1, n2=n2, rate=rate)
    with pytest.raises(ValueError, match="power"):
        paired_detectable_difference(n=3, discordance=0.1, power=1.0)
    with pytest.raises(ValueError, match="standard error"):
        detectable_from_standard_error(-1.0)
