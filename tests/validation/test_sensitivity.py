"""Sensitivity also varies what only newer persons have."""

from __future__ import annotations

import pytest

from carecontact.protocols import load_protocol
from carecontact.sim.simulation import Simulation
from carecontact.validation import sensitivity
from carecontact.validation.scores import Scores
from carecontact.validation.subject import Subject
from carecontact.world.human.versions import BUILDS

SHIPPED_M = BUILDS["person-v2"].layer_m


@pytest.mark.parametrize(
    ("protocol", "wanted"), [("bathing-v2", {0.0}), ("bathing-v3-draft", {SHIPPED_M, SHIPPED_M / 2, SHIPPED_M * 2})]
)
def test_the_depth_over_which_the_layer_stiffens_is_varied_where_it_does(
    protocol: str, wanted: set[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    found: set[float] = set()

    def scores_of(simulation: Simulation, *_: object) -> Scores:
        model = simulation.model
        names = [model.numeric(k).name for k in range(model.nnumeric)]
        found.add(float(model.numeric("forearm/contact").data[0]) if "forearm/contact" in names else 0.0)
        return Scores(c1_n=1.0, c1_filtered_n=1.0, c5_n=1.0, stroke_m=1.0, beyond_measured=0.0)

    monkeypatch.setattr(sensitivity, "scores_of", scores_of)
    monkeypatch.setattr(sensitivity, "perform", lambda *_: None)
    sensitivity.run(Subject(load_protocol(protocol)), quick=False)
    assert found == wanted
