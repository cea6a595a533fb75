"""Gauss-Newton steps within bounds."""

from __future__ import annotations

import numpy as np

from carecontact.calibration.problem import moved_back, step_within

LOW, HIGH = np.array([-9.0, 0.0, 0.0]), np.array([9.0, 5.0, 1.0])


def test_a_step_inside_the_bounds_is_newtons() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    normal, p, want = root @ root.T, np.array([1.0, 1.0, 0.5]), np.array([0.8, 1.5, 0.4])
    np.testing.assert_allclose(step_within(p, normal, normal @ (p - want), LOW, HIGH), want, atol=1e-6)


def test_what_stops_at_a_bound_is_made_up_for() -> None:
    """The least of the quadratic within the bounds, found by looking everywhere."""
    normal = np.array([[2.0, 0.9, 0.3], [0.9, 1.0, 0.2], [0.3, 0.2, 0.8]])
    p = np.array([0.5, 0.4, 0.3])
    free = np.array([0.2, -0.7, 0.5])
    stepped = step_within(p, normal, normal @ (p - free), LOW, HIGH)
    assert stepped[1] == 0.0

    def value(q: np.ndarray) -> float:
        return float((q - free) @ normal @ (q - free))

    rng = np.random.default_rng(2)
    others = np.clip(stepped + rng.normal(scale=0.2, size=(2000, 3)), LOW, HIGH)
    assert value(stepped) <= min(map(value, others)) + 1e-9


def test_a_share_that_a_resample_holds_at_zero_stays_there() -> None:
    """Where the full step too ends at zero, taking it off would give back the optimum and hide the way down to zero."""
    optimum = np.array([1.0, 0.2, 0.5])
    full, resampled = np.array([1.1, 0.0, 0.5]), np.array([0.9, 0.0, 0.6])
    np.testing.assert_allclose(moved_back(resampled, full - optimum, LOW, HIGH), [0.8, 0.0, 0.6])
