"""A random trial that leaves anything in the state that is not a number is a broken one."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.kernel.readings import HELD_SIZE, POINTS_EACH
from carecontact.sim.cartesian_control import CartesianControl
from carecontact.sim.simulation import Simulation
from carecontact.validation import stability
from carecontact.validation.stability import random_trial
from carecontact.validation.subject import Subject


def first_sum_of_the_cells(simulation: Simulation, region: str) -> int:
    """The index in ``plugin_state`` of a number that nothing in a step reads."""
    felt = simulation.tissue[region]
    triangles = simulation.model.numeric(f"{region}/triangles").data.size // 5
    return felt.steps_at + 3 + 6 * len(felt.places) + HELD_SIZE * POINTS_EACH * triangles


@pytest.mark.parametrize("spoilt", [False, True])
def test_a_random_trial_is_whole_if_its_whole_state_is_finite(subject: Subject, spoilt: bool) -> None:
    simulation = subject.hovering("forearm")
    if spoilt:
        simulation.data.plugin_state[first_sum_of_the_cells(simulation, "forearm")] = np.nan
    peak, _, whole = random_trial(simulation, "forearm", np.random.default_rng(1))
    assert whole is not spoilt
    assert np.isnan(peak) == spoilt


def test_a_robot_that_is_not_held_back_fails(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    assert stability.run(subject, quick=True).passed
    monkeypatch.setattr(CartesianControl, "_hold_back", lambda self: None)
    missed = stability.run(subject, quick=True).missed
    assert [measure.name for measure in missed] == ["share of trials with a tool faster than 0.4 m/s"]
