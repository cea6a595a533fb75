"""What the body's curvature explains of a force."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.validation.subject import Subject
from carecontact.validation.uniformity import curvatures, unexplained


def test_a_limb_is_round_across_and_nearly_straight_along(subject: Subject) -> None:
    shell = subject.scene("forearm").regions["forearm"].shell
    along, across = curvatures(shell, np.zeros(2))
    assert across == pytest.approx(1 / shell.radius_m, rel=0.35)
    assert abs(along) < 0.2 * across


def test_only_what_curvature_does_not_explain_is_left() -> None:
    rng = np.random.default_rng(0)
    curvature = rng.normal(size=(60, 2))
    own = rng.normal(size=60)
    force = 5.0 + curvature @ [0.3, -0.2]
    assert unexplained(force, curvature) < 1e-12
    assert unexplained(force + 0.1 * own, curvature) == pytest.approx(0.02, rel=0.3)
