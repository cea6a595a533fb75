from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.embodiment import PANDA
from carecontact.validation.fem.tools import CAP, EDGE_M, STEEPEST, ball, disc


def test_a_ball_is_a_ball_and_goes_on_as_a_cone() -> None:
    r, zero = np.array([0.0, 0.003, 0.006]), np.zeros(3)
    np.testing.assert_allclose(ball(0.01).height(r, zero), 0.01 - np.sqrt(0.01**2 - r**2))
    np.testing.assert_allclose(ball(0.01).height(zero, r), ball(0.01).height(r, zero))
    outside = ball(0.01).height(np.array([0.011, 0.012]), np.zeros(2))
    assert np.diff(outside)[0] == pytest.approx(STEEPEST * 0.001)


def test_the_cap_is_the_robots_ellipsoid_lying_across() -> None:
    along, across, up = PANDA.tip.half_m
    assert across > along
    height = CAP.height(np.array([along * 0.6, 0.0]), np.array([0.0, across * 0.6]))
    np.testing.assert_allclose(height, up * (1 - 0.8))


def test_a_disc_has_a_flat_face_and_a_round_rim() -> None:
    height = disc(0.01).height(np.array([0.0, 0.004, 0.008, 0.009]), np.zeros(4))
    rim = EDGE_M - np.sqrt(EDGE_M**2 - 0.001**2)
    np.testing.assert_allclose(height, [0.0, 0.0, 0.0, rim], atol=1e-12)


@pytest.mark.parametrize("tool", [ball(0.01), ball(0.02), CAP])
def test_nothing_lies_under_a_tool_beyond_its_reach(tool) -> None:
    turn = np.linspace(0, 2 * np.pi, 50)
    for factor, inside in ((0.97, True), (1.01, False)):
        r = factor * tool.reach_m(0.004)
        assert (tool.height(r * np.cos(turn), r * np.sin(turn)) < 0.004).any() == inside
