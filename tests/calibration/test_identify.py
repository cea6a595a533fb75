"""Laws identified from presses that were made with one of them."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import make_curve
from carecontact.calibration.identify import identify
from tests.calibration.conftest import rows, save


@pytest.mark.parametrize("seed", [1, 2])
def test_hunt_crossley_is_found_with_its_exponent_and_loss(seed: int, generator: ModuleType, tmp_path: Path) -> None:
    truth = generator.make("abdomen", "analytic", tmp_path / "t.csv", seed=seed)["law"]
    curves = [make_curve(trial) for trial in read_trials(tmp_path / "t.csv", region="abdomen").trials]
    best, *others = identify(curves)
    assert best.law.name == "hunt-crossley"
    found = best.physical()
    assert found["n"] == pytest.approx(truth["n"], rel=0.06)
    assert found["beta_s_mm"] * 1000 == pytest.approx(truth["beta_s_m"], rel=0.15)
    assert best.left_out_rms is not None
    assert all(best.left_out_rms < one.left_out_rms for one in others if one.left_out_rms is not None)


def test_loading_alone_of_a_straight_line_is_linear(tmp_path: Path) -> None:
    lines = [row for k in range(4) for row in rows(f"t{k}", depth=4.0 + 0.1 * k)]
    curves = [make_curve(trial) for trial in read_trials(save(tmp_path / "t.csv", lines), region="forearm").trials]
    found = {one.law.name: one for one in identify(curves)}
    assert found["linear"].physical()["k_N_mm"] == pytest.approx(1.0, rel=0.01)
    assert found["linear"].rms < 0.01


def test_single_trial_has_no_left_out_error(analytic_csv: Path) -> None:
    curve = make_curve(read_trials(analytic_csv, region="forearm").trials[0])
    assert all(one.left_out_rms is None for one in identify([curve]))
