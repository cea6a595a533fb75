"""What the body's curvature explains of a force."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.sim.bench import Bench
from carecontact.validation import uniformity
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


def test_a_spring_and_not_a_depth_is_what_a_trial_has(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """Skin whose stiffness differs from place to place by 10 %: the robot's spring of 1,000 N/m leaves half of it. Such
    places lie anyhow, so that curvature explains little of it."""
    turn = iter([0.9, 1.1] * 10)

    def press(bench: Bench, place: np.ndarray) -> np.ndarray:
        return next(turn) * 1000.0 * np.add.outer(uniformity.DEPTHS_M, (-uniformity.TANGENT_M, 0.0))

    monkeypatch.setattr(uniformity, "_press", press)
    found = {measure.name: measure for measure in uniformity.run(subject, quick=True).measures}
    at_4_mm = [measure for name, measure in found.items() if "4 mm" in name]
    spread = 100 * np.std([0.9, 1.1] * 10, ddof=1)
    assert [measure.value for measure in at_4_mm] == pytest.approx([spread, spread / 2, spread], rel=0.1)
    assert [measure.met for measure in at_4_mm] == [None, False, False]
