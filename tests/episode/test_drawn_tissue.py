"""A trial whose seed draws how stiff the person's tissue is, and what its recording says of it."""

from __future__ import annotations

from dataclasses import astuple, fields

import numpy as np

from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import constants_of, settled_world
from carecontact.episode.randomization import streams
from carecontact.kernel.region import Law
from carecontact.protocols import load_protocol, overridden
from carecontact.world.human.spread import draw_tissue

DRAWN = overridden(load_protocol(), {"variation.tissue": "published-v1"})
COLUMNS = [field.name for field in fields(Law)]


def laws(protocol: Protocol, seed: int) -> np.ndarray:
    simulation, settled, _ = settled_world(protocol, task_id="T1", seed=seed)
    return constants_of(simulation, settled)["scorer/region_law"]


def test_a_seed_draws_its_tissue_again_and_another_seed_another() -> None:
    first, again, other = laws(DRAWN, 0), laws(DRAWN, 0), laws(DRAWN, 1)
    np.testing.assert_array_equal(first, again)
    assert (first[:, 0] != other[:, 0]).all()
    rows = draw_tissue(streams(DRAWN, 0, "")["tissue"], DRAWN.person.tissue)
    np.testing.assert_array_equal(first, [astuple(Law.of(rows[name])) for name in DRAWN.regions])
    same = [COLUMNS.index(name) for name in ("friction", "thickness_m", "contact_n_m3", "membrane_n_m")]
    np.testing.assert_array_equal(first[:, same], other[:, same])


def test_the_person_lies_as_without_the_draw_and_only_then_the_law_is_recorded() -> None:
    plain, drawn = (settled_world(rules, task_id="T1", seed=0) for rules in (load_protocol(), DRAWN))
    np.testing.assert_array_equal(plain[0].integration_state(), drawn[0].integration_state())
    assert plain[2] == drawn[2], "the compiled model is the same: the draw belongs to the seed"
    assert "scorer/region_law" not in constants_of(plain[0], plain[1])


def test_a_recording_holds_the_law_of_a_body_of_another_build() -> None:
    rules = overridden(load_protocol(), {"person.body": "woman-adult-heavy"})
    spec = TrialSpec(protocol=rules, task_id="T1", seed=0, policy="blind")
    card = PolicyCard(name="blind", modalities=(), cameras=(), control_hz=10)
    with Episode(spec, card=card) as episode:
        episode.reset()
        episode.step(Action(done=True))
        recording = episode.finish()
    law = recording["scorer/region_law"]
    declared = np.array([astuple(Law.of(rules.person.tissue[name])) for name in rules.regions])
    thickness, stiffness = COLUMNS.index("thickness_m"), COLUMNS.index("a_n_m3")
    assert (law[:, thickness] > declared[:, thickness]).all()
    assert (law[:, stiffness] < declared[:, stiffness]).all()
