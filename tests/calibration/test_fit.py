"""Which terms a law gets, on presses of the forearm without noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.calibration.agreement import pooled
from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import make_curve
from carecontact.calibration.fit import Fit, fit_law
from carecontact.calibration.replay import Replay, group_curves
from carecontact.protocols import load_protocol
from carecontact.world.human.library import load_body
from tests.calibration.conftest import save


def fitted(path: Path, exponent: float, *, trials: int = 4) -> Fit:
    """Loading with a ball: 4 N at 4 mm, as this power of depth, a few percent apart."""
    lines = []
    for number in range(trials):
        travel = np.linspace(-1.0, 4.0, 120)
        force = 4.0 * (1 + 0.02 * (number - 1.5)) * (np.maximum(travel, 0.0) / 4.0) ** exponent
        lines += [
            f"t{number},forearm,p{number},{(d + 1) / 10:.5f},{d:.5f},{f:.5f},load,10,hemisphere,10,0,none"
            for d, f in zip(travel, force, strict=True)
        ]
    curves = [make_curve(trial) for trial in read_trials(save(path, lines), region="forearm").trials]
    tissue = load_protocol().person.tissue["forearm"]
    replay = Replay(body=load_body("man-adult"), region="forearm", tissue=tissue, groups=group_curves(curves))
    return fit_law(curves, replay=replay)


@pytest.mark.parametrize("exponent", [1.3, 2.2])
def test_the_law_bends_as_the_response_does(exponent: float, tmp_path: Path) -> None:
    """On straight anchors a ball meets about d^1.5: what is straighter needs b below zero, what is steeper more."""
    fit = fitted(tmp_path / "t.csv", exponent)
    assert "growth" not in fit.terms, "nothing unloads"
    steeper = 2 * fit.tissue.b_n_m4 + 3 * fit.tissue.c_n_m5 * 0.004
    assert fit.tissue.b_n_m4 < 0 if exponent < 1.5 else steeper > 0
    errors = pooled(fit.agreement)
    assert errors["tangent_error"] == pytest.approx(0.0, abs=0.05)
    assert errors["nrmse"] == pytest.approx(0.0, abs=0.04)


def test_too_few_trials_choose_nothing(tmp_path: Path) -> None:
    fit = fitted(tmp_path / "t.csv", 1.3, trials=2)
    assert fit.terms == ("rise",)
    assert fit.tissue.b_n_m4 == 0.0
    assert fit.chosen == ("too few trials to choose the law's terms",)


def test_where_no_law_follows_the_forces_stiffness_does_not_pay_for_it(tmp_path: Path) -> None:
    """Hardly any law lets a ball meet a straight line. By forces alone, the tangent would be a fifth too high."""
    errors = pooled(fitted(tmp_path / "t.csv", 1.05).agreement)
    assert errors["tangent_error"] == pytest.approx(0.0, abs=0.1)
    assert errors["peak_error"] == pytest.approx(0.0, abs=0.1)
