"""What the check of sensitivity varies."""

from __future__ import annotations

import pytest

from carecontact.kernel.region import LAYER_M
from carecontact.protocols import load_protocol
from carecontact.sim.simulation import Simulation
from carecontact.validation import sensitivity
from carecontact.validation.scores import Scores
from carecontact.validation.subject import Subject


def test_the_depth_over_which_the_layer_stiffens_is_varied(monkeypatch: pytest.MonkeyPatch) -> None:
    found: set[float] = set()

    def scores_of(simulation: Simulation, *_: object) -> Scores:
        found.add(float(simulation.model.numeric("forearm/contact").data[0]))
        return Scores(c1_n=1.0, c1_filtered_n=1.0, c5_n=1.0, stroke_m=1.0, beyond_measured=0.0)

    monkeypatch.setattr(sensitivity, "scores_of", scores_of)
    monkeypatch.setattr(sensitivity, "perform", lambda *_: None)
    sensitivity.run(Subject(load_protocol()), quick=False)
    assert found == {LAYER_M, LAYER_M / 2, LAYER_M * 2}
