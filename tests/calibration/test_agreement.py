"""Error measures against curves whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.calibration.agreement import agreement, pooled

DEPTH = np.linspace(0.0, 0.004, 41)
LINE, NONE = 1000 * DEPTH, np.full(41, np.nan)


def test_equal_curves_have_no_error() -> None:
    same = agreement(DEPTH, (LINE, 0.8 * LINE), (LINE, 0.8 * LINE))
    assert (same.nrmse, same.peak_error, pooled([same])["work_error"]) == (0.0, 0.0, 0.0)
    assert same.r2 == 1.0


@given(share=st.floats(-0.3, 0.3))
def test_stiffer_by_a_share(share: float) -> None:
    one = agreement(DEPTH, (LINE, 0.8 * LINE), ((1 + share) * LINE, (1 + share) * 0.8 * LINE))
    assert one.peak_error == pytest.approx(share, abs=1e-9)
    assert one.tangent_error == pytest.approx(share, abs=1e-9)
    assert pooled([one])["work_error"] == pytest.approx(share, abs=1e-9)


def test_nrmse_is_over_the_measured_peak() -> None:
    assert agreement(DEPTH, (LINE, NONE), (LINE + 0.2, NONE)).nrmse == pytest.approx(0.05)


def test_missing_legs_and_depths_are_left_out() -> None:
    cut = np.where(DEPTH <= 0.003, LINE, np.nan)
    one = agreement(DEPTH, (LINE, NONE), (cut, NONE))
    assert one.nrmse == 0.0
    assert one.work_j is None


def test_pooling() -> None:
    rows = [agreement(DEPTH, (LINE, NONE), (LINE + e, NONE)) for e in (0.0, 0.4)]
    whole = pooled(rows)
    assert whole["nrmse"] == pytest.approx(np.sqrt((0.0 + 0.1**2) / 2))
    assert whole["peak_error"] == pytest.approx(0.05)
    assert whole["work_error"] is None


def test_the_error_of_work_is_that_of_all_trials_together() -> None:
    """A thin loop that is twice too wide counts less than a wide one that is right."""
    thin = agreement(DEPTH, (LINE, 0.9 * LINE), (LINE, 0.8 * LINE))
    wide = agreement(DEPTH, (LINE, 0.5 * LINE), (LINE, 0.5 * LINE))
    assert pooled([thin, wide])["work_error"] == pytest.approx((0.2 + 0.5) / (0.1 + 0.5) - 1)


def test_a_loop_without_losses_has_an_error_all_the_same() -> None:
    """Relative to a hundredth of the work of the loading."""
    one = agreement(DEPTH, (LINE, LINE), (LINE, 0.95 * LINE))
    assert pooled([one])["work_error"] == pytest.approx(0.05 / 0.01 - 1)
