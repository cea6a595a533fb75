from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.episode.base_placement import Base, PlacementCheck
from carecontact.episode.placed_persons import PlacedPerson, placed_person, survey_placement
from carecontact.episode.randomization import draw
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.world.draws import body_of, overhead_of, place_of, posture_of

L1, L2, L3 = (load_protocol("bathing-wide-v2", level=name) for name in ("L1", "L2", "L3"))
SEED = 10


@pytest.fixture(scope="module")
def found() -> PlacedPerson:
    return placed_person(L2, SEED)


def test_every_block_of_nine_seeds_has_every_body_once() -> None:
    blocks = [[body_of(L2, seed, "") for seed in range(first, first + 9)] for first in (0, 9, 18)]
    assert all(sorted(block) == sorted(L2.variation.bodies) for block in blocks)
    assert len({tuple(block) for block in blocks}) == 3
    assert [body_of(L3, seed, "") for seed in range(9)] == blocks[0]


def test_a_person_is_the_same_on_all_levels_and_lies_on_one_side(found: PlacedPerson) -> None:
    near = placed_person(L1, SEED)
    assert (near.body, near.posture) == (found.body, found.posture)
    assert placed_person(L3, SEED).bases == found.bases
    one, two = (place_of(found.posture.place, rules.variation) for rules in (L1, L2))
    assert np.sign(one.along_m) == np.sign(two.along_m)
    assert abs(one.along_m) < abs(two.along_m)
    assert two.along_m <= 0.05


def test_the_base_that_was_taken_serves_and_others_are_refused(found: PlacedPerson) -> None:
    ground = PlacementCheck(L2, SEED, "", found.laid, found.posture)
    for region, base in found.bases.items():
        assert ground.refusal(base, region) is None
        x, y, z = base.position_m
        assert ground.refusal(replace(base, position_m=(x, 0.5, z)), region) == "bed"
        assert ground.refusal(replace(base, position_m=(x - 0.6, y, z)), region) == "reach"
    # Under the board, and turned away so far that the parked tool is over the person.
    assert ground.refusal(Base(position_m=(0.3, 0.7, 0.6), yaw_deg=0.0), "forearm") == "board"


def test_the_drawn_protocol_has_the_person_and_the_base(found: PlacedPerson) -> None:
    made = draw(L2, region="abdomen", seed=SEED)
    base = found.bases["abdomen"]
    assert made.protocol.person.body == found.body
    assert (made.protocol.scene.robot_base_m, made.protocol.scene.robot_yaw_deg) == (base.position_m, base.yaw_deg)
    assert (made.protocol.id, made.protocol.tasks, made.protocol.gates) == (L2.id, L2.tasks, L2.gates)
    assert draw(L2, region="forearm", seed=SEED).protocol.scene.robot_base_m == found.bases["forearm"].position_m


def test_the_overhead_camera_stays_within_its_range_and_differs_with_the_seed() -> None:
    at = np.array(L2.cameras["overhead"].position_m)
    moved = np.array([overhead_of(L2, seed, "").position_m for seed in range(30)]) - at
    assert (np.abs(moved) <= 0.05).all()
    assert (np.ptp(moved, axis=0) > 0.05).all()
    assert overhead_of(L1, 0, "") == L1.cameras["overhead"]


def test_a_salt_draws_another_person() -> None:
    assert posture_of(L2, SEED, "ab" * 16, 0) != posture_of(L2, SEED, "", 0)


def impossible(protocol: Protocol) -> Protocol:
    assert protocol.variation.parking is not None
    far = protocol.variation.parking.model_copy(update={"centre_m": (-1.5, 0.7, 0.6), "tries": 3})
    return protocol.model_copy(update={"variation": protocol.variation.model_copy(update={"parking": far})})


def test_a_seed_without_a_base_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.episode.placed_persons.MOST_PERSONS", 1)
    lost = survey_placement(impossible(L2), SEED)
    assert lost.found is None
    assert "none of 1 draws of" in lost.why
