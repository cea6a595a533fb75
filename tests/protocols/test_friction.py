from __future__ import annotations

import pytest

from carecontact.contract.protocol.title import protocol_title
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol, overridden
from carecontact.protocols.friction import SKIN_STATES, friction_changes

RULES = load_protocol("bathing-v3-draft")


@pytest.mark.parametrize(("friction", "value"), [(k, s.coefficient) for k, s in SKIN_STATES.items()] + [("0.8", 0.8)])
def test_every_soft_region_gets_the_coefficient(friction: str, value: float) -> None:
    changed = overridden(RULES, {"person.tissue_set": "human-published", **friction_changes(RULES, friction)})
    assert {region: changed.person.tissue[region].friction for region in RULES.soft_regions} == dict.fromkeys(
        RULES.soft_regions, value
    )
    assert changed.person.tissue_set == "human-published"


def test_states_have_sources_and_lie_in_their_order() -> None:
    assert SKIN_STATES["soapy"].coefficient < SKIN_STATES["dry"].coefficient < SKIN_STATES["wet"].coefficient
    assert all(state.source for state in SKIN_STATES.values())


def test_a_title_says_one_friction_once() -> None:
    assert overridden(RULES, friction_changes(RULES, "wet")).title == "bathing-v3-draft with friction 1"
    two = {"person.tissue.forearm.friction": "1", "person.tissue.abdomen.friction": "0.8"}
    assert protocol_title("x", two) == (
        "x with person.tissue.abdomen.friction 0.8 and person.tissue.forearm.friction 1"
    )


@pytest.mark.parametrize("friction", ["slimy", "", "wet "])
def test_another_word_is_refused(friction: str) -> None:
    with pytest.raises(ConfigError, match=r"--friction .*: expected dry, wet, soapy or a coefficient, such as 0\.8"):
        friction_changes(RULES, friction)
