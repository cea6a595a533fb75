from __future__ import annotations

import numpy as np
import pytest

from carecontact.errors import CarecontactError
from carecontact.validation.fem.answer import Curve, rings, touch_m
from carecontact.validation.fem.cases import CASES, DEPTHS_M, RINGS_M
from tests.validation.fem.made_up import power


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
@pytest.mark.parametrize("word", ["ball", "disc"])
def test_an_exponent_is_the_slope_over_the_three_sizes(case, word) -> None:
    np.testing.assert_allclose(power(case, 0.7, scale=100).exponents(case, word), 0.7, rtol=0.02)


def test_a_curve_counts_depth_from_each_press_own_touch() -> None:
    depth = np.linspace(0.0, 0.006, 601)
    late = np.maximum(depth - 0.001, 0.0)
    curve = Curve(presses=((depth, 100 * depth), (depth, 100 * late)))
    np.testing.assert_allclose(curve.at(DEPTHS_M, touch_n=0.02), 100 * DEPTHS_M + 0.02, rtol=1e-3)
    assert curve.touch_m(0.02) == pytest.approx(0.0007, rel=1e-3)


def test_touch_lies_between_samples_and_has_to_come() -> None:
    travel = np.array([0.0, 0.001, 0.002])
    assert touch_m(travel, np.array([0.0, 0.01, 0.03]), 0.02) == pytest.approx(0.0015)
    with pytest.raises(CarecontactError, match="never exceeds"):
        touch_m(travel, np.zeros(3), 0.02)


def test_a_ring_is_the_mean_about_its_distance() -> None:
    places = np.array([[0.003, 0.0], [0.0, 0.005], [0.0201, 0.001]])
    sunk = np.array([1.0, 3.0, 5.0])
    found = rings(places, sunk)
    assert rings(places, sunk, beside=True)[0] == 1.0
    assert found[0] == 2.0
    assert found[list(np.round(1000 * RINGS_M)).index(20)] == 5.0
    assert np.isnan(found[list(np.round(1000 * RINGS_M)).index(12)])
