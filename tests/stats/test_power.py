from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.stats import (
    detectable_from_standard_error,
    mcnemar_exact,
    paired_detectable_difference,
    unpaired_detectable_difference,
)


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


@settings(deadline=None)
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


def test_refuses() -> None:
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
