"""The Butterworth filters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from carecontact.scoring.filters import low_pass

SIGNAL = np.random.default_rng(0).normal(size=(400, 3))


@pytest.mark.parametrize(("cutoff_hz", "sample_hz"), [(5.0, 50.0), (20.0, 500.0), (30.0, 250.0), (99.9, 200.0)])
@pytest.mark.parametrize("length", [1, 2, 9, 10, 400])
def test_every_number_is_that_of_scipy(cutoff_hz: float, sample_hz: float, length: int) -> None:
    sections = signal.butter(2, cutoff_hz, fs=sample_hz, output="sos")
    part = SIGNAL[:length]
    once = low_pass(part, cutoff_hz=cutoff_hz, sample_hz=sample_hz, zero_phase=False)
    np.testing.assert_array_equal(once, signal.sosfilt(sections, part, axis=0))
    both = low_pass(part, cutoff_hz=cutoff_hz, sample_hz=sample_hz, zero_phase=True)
    np.testing.assert_array_equal(both, signal.sosfiltfilt(sections, part, axis=0, padlen=min(length - 1, 9)))


@pytest.mark.parametrize("shape", [(400,), (0, 3), (7, 0), (20, 2, 3)])
def test_the_shape_stays(shape: tuple[int, ...]) -> None:
    assert low_pass(np.ones(shape), cutoff_hz=5.0, sample_hz=50.0, zero_phase=True).shape == shape


@pytest.mark.parametrize("cutoff_hz", [0.0, 25.0, 30.0])
def test_a_cutoff_that_no_filter_has_is_refused(cutoff_hz: float) -> None:
    with pytest.raises(ValueError, match="half"):
        low_pass(SIGNAL, cutoff_hz=cutoff_hz, sample_hz=50.0, zero_phase=False)
