from __future__ import annotations

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.oracle import hand
from carecontact.oracle.hand import CLEAR_M, hold
from carecontact.oracle.truth import Truth
from carecontact.policies.motion import radial_quat
from carecontact.sim.simulation import Simulation


def test_a_free_place_is_touched_straight_from_above(simulation: Simulation) -> None:
    place = Truth(simulation, "forearm").geometry().centre_m
    state = simulation.integration_state()
    held = hold(simulation, "forearm", place[None])
    assert (held.reached, held.clear_m) == (True, CLEAR_M)
    assert abs(float(held.quat_wxyz @ radial_quat(place))) > 1 - 1e-9
    assert np.array_equal(simulation.integration_state(), state), "trying postures leaves the trial as it is"


def test_the_hand_turns_where_it_would_land_on_the_person(simulation: Simulation, monkeypatch) -> None:
    """Beside the head, the hand that points straight down hits it, and a turned or leant one has more room."""
    data = simulation.data
    head = simulation.encoders.in_base(data, data.geom("human_hull_head").xpos, np.eye(3))[:3, 3]
    chest = simulation.encoders.in_base(data, data.geom("human_hull_right_chest").xpos, np.eye(3))[:3, 3]
    place = Truth(simulation, "upper_arm").geometry().centre_m
    beside = place + 0.35 * ((head + chest) / 2 - place) * [1, 1, 0]
    straight = hand._Arm(simulation, "upper_arm").tried(radial_quat(beside), beside[None])
    found = hold(simulation, "upper_arm", beside[None])
    assert straight.clear_m < CLEAR_M
    assert found.rank > straight.rank
    assert matrix_from_quat(found.quat_wxyz)[2, 2] < -0.9


def test_a_place_out_of_reach_is_not_reached(simulation: Simulation) -> None:
    assert not hold(simulation, "forearm", np.array([[1.6, 0.0, 0.2]])).reached
