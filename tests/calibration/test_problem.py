"""Gauss-Newton steps within bounds, and the errors of stiffness that a fit makes small."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import make_curve
from carecontact.calibration.problem import moved_back, step_within, stiffness_errors

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


def test_the_error_of_stiffness_is_blind_to_losses(analytic_csv: Path) -> None:
    """A tenth too stiff, whatever the loop between both ways; a trial without a way back is judged by its way in."""
    curve = make_curve(read_trials(analytic_csv, region="forearm").trials[0])
    loop = 0.2 * curve.peak_n * np.sin(np.linspace(0, np.pi, len(curve.grid_m)) / 2)
    errors = stiffness_errors(curve, 1.1 * curve.loading_n + loop, 1.1 * curve.unloading_n - loop)
    np.testing.assert_allclose(errors, 0.1)
    one_way = replace(curve, trial=replace(curve.trial, phase=np.zeros_like(curve.trial.phase)))
    np.testing.assert_allclose(stiffness_errors(one_way, 1.1 * curve.loading_n, curve.unloading_n), 0.1)
    steeper = 1.1 * curve.loading_n * curve.grid_m / curve.grid_m[-1]
    end, slope = stiffness_errors(one_way, steeper, curve.unloading_n)
    assert slope > end > 0.0
