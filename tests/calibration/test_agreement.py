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
    assert (same.nrmse, same.peak_error, same.loop_error) == (0.0, 0.0, 0.0)
    assert same.r2 == 1.0


@given(share=st.floats(-0.3, 0.3))
def test_stiffer_by_a_share(share: float) -> None:
    one = agreement(DEPTH, (LINE, 0.8 * LINE), ((1 + share) * LINE, (1 + share) * 0.8 * LINE))
    assert one.peak_error == pytest.approx(share, abs=1e-9)
    assert one.tangent_error == pytest.approx(share, abs=1e-9)
    assert one.loop_error == pytest.approx(share, abs=1e-9)


def test_nrmse_is_over_the_measured_peak() -> None:
    assert agreement(DEPTH, (LINE, NONE), (LINE + 0.2, NONE)).nrmse == pytest.approx(0.05)


def test_missing_legs_and_depths_are_left_out() -> None:
    cut = np.where(DEPTH <= 0.003, LINE, np.nan)
    one = agreement(DEPTH, (LINE, NONE), (cut, NONE))
    assert one.nrmse == 0.0
    assert one.loop_error is None


def test_pooling() -> None:
    rows = [agreement(DEPTH, (LINE, NONE), (LINE + e, NONE)) for e in (0.0, 0.4)]
    whole = pooled(rows)
    assert whole["nrmse"] == pytest.approx(np.sqrt((0.0 + 0.1**2) / 2))
    assert whole["peak_error"] == pytest.approx(0.05)
    assert whole["loop_error"] is None
