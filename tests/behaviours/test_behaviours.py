"""Every registered action: its schema, its sweeps and its words hold together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from carecontact.behaviours import BEHAVIOURS, Behaviour, Section
from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols import load_protocol
from carecontact.scoring import score_recording
from carecontact.scoring.behaviour import actions_that_move, behaviour_of
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.c3_success import judge
from tests.scoring.gates_v2 import GENTLE
from tests.scoring.synthetic import make_recording, push, scrub, touch

PROTOCOL = load_protocol()
VERSIONS = ("gates-v1", "gates-v2")
GOOD = {"touch": touch, "push": push, "scrub": scrub}


def test_one_file_each_registers_the_shipped_actions() -> None:
    assert set(GOOD) <= set(BEHAVIOURS)
    assert actions_that_move() >= {"push"}
    assert not actions_that_move() & {"touch", "scrub"}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("action", sorted(BEHAVIOURS))
def test_sweeps_move_fields_of_the_gate(action: str, version: str) -> None:
    behaviour = behaviour_of(action, version)
    assert issubclass(behaviour.gate, Section)
    for sweep in behaviour.sweeps:
        assert sweep.field in behaviour.gate.model_fields
        assert sweep.name.startswith(f"{action}_")
        assert sorted(sweep.values) == list(sweep.values)


@pytest.mark.parametrize("protocol", [PROTOCOL, GENTLE], ids=lambda protocol: protocol.gates.version)
@pytest.mark.parametrize("action", sorted(GOOD))
def test_a_good_trial_passes_and_an_empty_one_is_told_what_is_missing(action: str, protocol: Protocol) -> None:
    assert score_recording(GOOD[action](protocol=protocol)).c3_success
    task = next(task.id for task in PROTOCOL.tasks if task.action == action)
    contact = find_contact(make_recording(task, protocol=protocol))
    result = judge(contact)
    assert not result.success
    assert behaviour_of(action, protocol.gates.version).shortfall(contact, protocol.gates.of(action), result)


def test_an_action_without_a_gate_in_the_protocol_lists_those_that_have_one() -> None:
    with pytest.raises(UnknownNameError, match="no gate named 'hold'; valid: push, scrub, touch"):
        PROTOCOL.gates.of("hold")


@pytest.mark.parametrize(("row", "what"), [(Behaviour, "the class Behaviour"), ("touch", "a str")])
def test_a_row_that_is_no_behaviour_object_is_refused(row: Any, what: str) -> None:
    with pytest.raises(ConfigError, match=f"^action 'odd' is {what}; expected a Behaviour object$"):
        BEHAVIOURS.register("odd", row)


def test_a_row_that_only_has_a_gate_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BEHAVIOURS._rows, "odd", SimpleNamespace(gate=Section))
    with pytest.raises(ConfigError, match="action 'odd' is registered as SimpleNamespace; expected a Behaviour object"):
        behaviour_of("odd", "gates-v1")
