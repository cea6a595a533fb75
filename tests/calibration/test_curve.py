"""Zeroing, baseline and grid against presses whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import TOUCH_SHARE, despiked, make_curve
from carecontact.calibration.trial import Condition, Trial
from carecontact.errors import ConfigError
from tests.calibration.conftest import rows, save

CONDITION = Condition(
    indenter_shape="hemisphere", indenter_size_m=0.01, speed_m_s=0.005, along_m=0.0, across_m=0.0, tilt_deg=0.0
)


def trial(
    *, zero_m: float = 0.0, offset: float = 0.0, drift: float = 0.0, noise: float = 0.0, k: float = 800.0
) -> Trial:
    """F = k d + 5e4 d^2 from 1.5 mm outside to 5 mm and back, at 5 mm/s."""
    time = np.arange(0.0, 2.6, 0.01)
    depth = 0.005 - 0.005 * np.abs(time - 1.3)
    rng = np.random.default_rng(3)
    inside = np.maximum(depth, 0.0)
    force = k * inside + 5e4 * inside**2 + offset + drift * time + noise * rng.normal(size=len(time))
    return Trial(
        trial_id="a", site="forearm", subject="p", condition=CONDITION, preload_n=0.0, filter="none", time_s=time,
        indentation_m=depth + zero_m, force_n=force, phase=np.where(time > 1.3, 2, 0), path=Path("t.csv"), line=2,
    )  # fmt: skip


@settings(max_examples=25)
@given(
    zero_m=st.floats(-0.002, 0.002), offset=st.floats(-1, 1), drift=st.floats(-0.1, 0.1), noise=st.floats(0, 0.02)
)  # fmt: skip
def test_zero_offset_and_drift_do_not_matter(zero_m: float, offset: float, drift: float, noise: float) -> None:
    curve = make_curve(trial(zero_m=zero_m, offset=offset, drift=drift, noise=noise))
    # Where the true force is the touch force.
    f = curve.touch_force_n
    at_touch = (-800 + np.sqrt(800**2 + 4 * 5e4 * f)) / 1e5
    truth = 800 * (curve.grid_m + at_touch) + 5e4 * (curve.grid_m + at_touch) ** 2
    np.testing.assert_allclose(curve.loading_n, truth, atol=0.02 + 2.5 * noise)
    # The way out begins a sample after the deepest point.
    np.testing.assert_allclose(curve.unloading_n[:-1], truth[:-1], atol=0.02 + 2.5 * noise)
    assert curve.drift_n_s == pytest.approx(drift, abs=0.01 + noise)


def test_touch_force_is_the_largest_of_three() -> None:
    quiet = make_curve(trial())
    assert quiet.touch_force_n == pytest.approx(TOUCH_SHARE * 5.25, rel=0.03)
    noisy = make_curve(trial(noise=0.1))
    assert noisy.touch_force_n == pytest.approx(3 * noisy.noise_n)
    preloaded = Trial(**{**vars(trial()), "preload_n": 0.5})
    assert make_curve(preloaded).touch_force_n == 0.5


def test_path_keeps_its_depth_and_speed() -> None:
    curve = make_curve(trial(noise=0.01))
    assert curve.path_m.max() == pytest.approx(curve.deepest_m, abs=1.5e-4)
    np.testing.assert_allclose(curve.loading_m_s[:30], 0.005, rtol=0.05)
    np.testing.assert_allclose(curve.unloading_m_s[:30], -0.005, rtol=0.05)


def test_a_trial_without_free_motion_starts_at_its_first_force(tmp_path: Path) -> None:
    pressed = read_trials(save(tmp_path / "t.csv", rows(n=120)[30:]), region="forearm").trials[0]
    curve = make_curve(pressed)
    assert curve.noise_n < 0.01
    assert curve.touch_force_n == pytest.approx(pressed.force_n[1], rel=0.2)


def test_a_trial_that_is_all_noise_is_refused() -> None:
    with pytest.raises(ConfigError, match="preload"):
        make_curve(trial(noise=0.8))


def test_spikes_go_and_peaks_stay() -> None:
    force = 5.0 - np.abs(np.linspace(-5.0, 5.0, 101))
    spiked = force.copy()
    spiked[20] += 24.0
    spiked[60:62] -= 3.0
    out = despiked(spiked)
    assert np.abs(out - force).max() < 0.25
    np.testing.assert_array_equal(np.delete(out, [20, 60, 61]), np.delete(force, [20, 60, 61]))
