from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.embodiment import PANDA
from carecontact.sim.bench import Indenter
from carecontact.validation.fem.profiles import STEEPEST, flat, on_a_cylinder, profile


def test_a_ball_is_a_ball_and_goes_on_as_a_cone() -> None:
    height = profile(Indenter(shape="hemisphere", size_m=0.01))
    r = np.array([0.0, 0.003, 0.006])
    np.testing.assert_allclose(height(r), 0.01 - np.sqrt(0.01**2 - r**2))
    outside = height(np.array([0.011, 0.012]))
    assert np.diff(outside)[0] == pytest.approx(STEEPEST * 0.001)


def test_the_cap_has_its_section_areas() -> None:
    along, across, tall = PANDA.cap_semi_axes_m
    height = 0.004
    share = 1 - (1 - height / tall) ** 2
    assert profile(Indenter(shape="cap"))(np.array([np.sqrt(along * across * share)]))[0] == pytest.approx(height)


def test_a_disc_has_a_face_a_dome_and_a_rim() -> None:
    height = flat(0.01, 0.002, 0.0003)
    np.testing.assert_allclose(height(np.array([0.0, 0.004, 0.008])), [0.0, 0.000075, 0.0003])
    assert height(np.array([0.009]))[0] == pytest.approx(0.0003 + 0.002 - np.sqrt(0.002**2 - 0.001**2))


def test_a_cylinder_falls_away_by_its_mean_over_a_circle() -> None:
    radius, r = 0.034, 0.01
    turn = np.linspace(0.0, 2 * np.pi, 1000, endpoint=False)
    mean = np.mean((r * np.sin(turn)) ** 2 / (2 * radius))
    assert on_a_cylinder(lambda r: 0 * r, radius)(np.array([r]))[0] == pytest.approx(mean)
