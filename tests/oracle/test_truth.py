from __future__ import annotations

import numpy as np
import pytest

from carecontact.errors import ContractError
from carecontact.oracle.truth import HARD_M, Truth, displaced
from carecontact.sim.simulation import Simulation
from carecontact.sim.true_skin import top_of_skin


@pytest.mark.parametrize("region", ["forearm", "upper_arm", "abdomen"])
def test_the_surface_is_where_the_visible_skin_is(simulation: Simulation, region: str) -> None:
    """The shell is a smoothed sample of the skin: both tops agree within millimetres along the whole stroke."""
    truth = Truth(simulation, region)
    geometry, skin = truth.geometry(), truth.skin()
    faces = simulation.model.skin_face.reshape(-1, 3)
    for along in np.linspace(-0.05, 0.05, 5):
        place = geometry.surface(float(along))
        assert abs(place[2] - top_of_skin(skin, faces, place[:2])) < 0.005


def test_the_region_begins_and_ends_where_the_scorer_measures_it(simulation: Simulation) -> None:
    """Over the ends of its axis, which on an arm that lies aslant are not straight above the joints."""
    truth = Truth(simulation, "upper_arm")
    geometry, frame = truth.geometry(), truth.frame()
    soft = (truth.surface() - frame[:3, 3]) @ frame[:3, 0]
    for along, end in ((-1, soft.min()), (1, soft.max())):
        place = geometry.surface(along * geometry.half_length_m)
        assert (place - frame[:3, 3]) @ frame[:3, 0] == pytest.approx(end - along * HARD_M, abs=0.006)


def test_a_limb_lies_on_its_board_and_the_belly_on_nothing(simulation: Simulation) -> None:
    forearm = Truth(simulation, "forearm").geometry()
    assert forearm.support_height_m is not None
    assert 0.03 < forearm.centre_m[2] - forearm.support_height_m < 0.12
    assert Truth(simulation, "abdomen").geometry().support_height_m is None


def test_places_move_with_their_frame(simulation: Simulation) -> None:
    before = Truth(simulation, "forearm").frame()
    turn = np.eye(4)
    turn[:2, :2], turn[:3, 3] = [[0.0, -1.0], [1.0, 0.0]], [0.1, 0.2, 0.3]
    point = before[:3, :3] @ [0.01, 0.02, 0.03] + before[:3, 3]
    assert displaced(point, before, turn @ before) == pytest.approx(turn[:3, :3] @ point + turn[:3, 3])


def test_nothing_presses_before_the_trial(simulation: Simulation) -> None:
    assert Truth(simulation, "forearm").force_n() == 0.0


def test_a_region_without_a_shell_is_refused(simulation: Simulation) -> None:
    with pytest.raises(ContractError, match="left_shank is none"):
        Truth(simulation, "left_shank")
