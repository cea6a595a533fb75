"""Every registered action: its schema, its sweeps and its words hold together."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from carecontact.behaviours import BEHAVIOURS, Behaviour, Section
from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocols import load_protocol
from carecontact.scoring import score_recording
from carecontact.scoring.attribution.commanded import CommandedContact
from carecontact.scoring.behaviour import actions_that_move, behaviour_of
from carecontact.scoring.contact import find_contact
from carecontact.scoring.gate import Attempt
from carecontact.scoring.metrics.c3_success import judge
from tests.scoring.exam_gates import GENTLE
from tests.scoring.synthetic import make_recording, push, scrub, touch

PROTOCOL = load_protocol()
GATES = ("paper", "exam")
GOOD = {"touch": touch, "push": push, "scrub": scrub}
PROGRESS = {
    "touch": (r"touched for 1\.\d+ s", r"touched for 1\.\d+ s, 1\.\d+ s of it gently"),
    "push": (r"wrist moved \d+ mm, pressed for \d\.\d+ s", r"wrist moved \d+ mm from where .*, pressed for .*"),
    "scrub": (r"stroke \d+ mm, extent \d+ mm, \d reversals", r"\d+ mm passed three times, \d+% of the sliding gently"),
}
"""Action -> what a progress line says of a good trial under the gates of the paper and of the exam."""
ASKED = {
    "touch": {"hold_s": 1.0}, "push": {"hold_s": 1.0, "way_m": 0.02}, "scrub": {"extent_m": 0.06, "reversals": 2},
}  # fmt: skip
"""Action -> the commanded contact that is just enough for the exam."""


def test_one_file_each_registers_the_shipped_actions() -> None:
    assert set(GOOD) <= set(BEHAVIOURS)
    assert actions_that_move() >= {"push"}
    assert not actions_that_move() & {"touch", "scrub"}


@pytest.mark.parametrize("gates", GATES)
@pytest.mark.parametrize("action", sorted(BEHAVIOURS))
def test_sweeps_move_fields_of_the_gate(action: str, gates: str) -> None:
    behaviour = behaviour_of(action, gates)
    assert issubclass(behaviour.gate, Section)
    for sweep in behaviour.sweeps:
        assert sweep.field in behaviour.gate.model_fields
        assert sweep.name.startswith(f"{action}_")
        assert sorted(sweep.values) == list(sweep.values)


@pytest.mark.parametrize("protocol", [PROTOCOL, GENTLE], ids=lambda protocol: protocol.gates.set)
@pytest.mark.parametrize("action", sorted(GOOD))
def test_a_good_trial_passes_and_an_empty_one_is_told_what_is_missing(action: str, protocol: Protocol) -> None:
    score = score_recording(GOOD[action](protocol=protocol))
    assert score.c3_success
    behaviour = behaviour_of(action, protocol.gates.set)
    assert re.fullmatch(PROGRESS[action][protocol is GENTLE], behaviour.progress(score))
    task = next(task.id for task in PROTOCOL.tasks if task.action == action)
    contact = find_contact(make_recording(task, protocol=protocol))
    result = judge(contact)
    assert not result.success
    assert behaviour.shortfall(contact, protocol.gates.of(action), result)


@pytest.mark.parametrize("action", ["touch", "push"])
def test_a_hold_of_just_the_required_time_is_enough(action: str) -> None:
    contact, gate = find_contact(GOOD[action](protocol=GENTLE)), GENTLE.gates.of(action)
    for held, enough in ((500, True), (499, False)):
        attempt = Attempt(held_steps=held, best=None, wrist_m=0.0, wrist_any_m=0.0)
        assert behaviour_of(action, GENTLE.gates.set).judge(contact, gate, attempt).time_met is enough


@pytest.mark.parametrize("action", sorted(ASKED))
def test_a_command_asks_for_enough_where_each_of_its_quantities_does(action: str) -> None:
    gate, behaviour = GENTLE.gates.of(action), behaviour_of(action, GENTLE.gates.set)
    enough = CommandedContact(**ASKED[action])
    assert behaviour.requested(gate, enough)
    for name, value in ASKED[action].items():
        less = value - 1 if isinstance(value, int) else 0.99 * value
        assert behaviour.requested(gate, replace(enough, **{name: less})) is None


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
        behaviour_of("odd", "paper")
