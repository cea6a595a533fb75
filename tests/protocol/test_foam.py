"""Foam in a protocol: an opt-in section with prompts of its own, and what it must not lack."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from carecontact.interface.regions import REGIONS, Region
from carecontact.protocol.load import load_levels, load_protocol, shipped_protocols
from carecontact.protocol.protocol import Protocol
from tests.protocol.foamy import FOAMY, LEVELS


def test_a_protocol_without_foam_says_nothing_of_it() -> None:
    """So its hash is that of before, and so is every recording's header."""
    for shipped in shipped_protocols():
        for rules in load_levels(shipped).values():
            for name in ("foam", "distractors"):
                if getattr(rules, name) is None:
                    assert name not in rules.model_dump(mode="json")


def test_foam_brings_its_own_prompts_and_changes_the_hash() -> None:
    plain = LEVELS["L0"]
    assert FOAMY.task("T1").prompt == "gently touch the foam on the right forearm"
    assert FOAMY.task("T2").prompt == plain.task("T2").prompt == "push the right forearm"
    assert [task.id for task in FOAMY.tasks if FOAMY.has_foam(task.id)] == ["T1", "T3", "T4", "T5", "T6", "T7"]
    assert plain.task("T1").prompt == "gently touch the right forearm"
    assert not plain.has_foam("T1")
    assert Protocol.model_validate(FOAMY.model_dump(mode="json")) == FOAMY
    assert FOAMY.model_copy(update={"foam": None}).sha256 != FOAMY.sha256


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("foam", "prompts"), {"T9": "touch it"}, "foam.prompts.T9: no such task; valid: T1, T2"),
        (("foam", "along"), [0.8, 0.2], "along: expected .low, high., low at most high"),
        (("foam", "colours"), ["pink"], "no colour named 'pink'; valid: cyan, lime, magenta"),
        (("foam", "colours"), [], "at least 1 item"),
        (("foam", "around_deg"), 90.0, "less than or equal to 60"),
        (("foam", "disc_m"), 25.0, "less than or equal to 0.2"),
        (("distractors", "colours"), ["lime"], "no colour named 'lime'; valid: orange, yellow, blue, red"),
        (("distractors", "towel_m"), [0.3, 0.1], "less than or equal to 0.2"),
        (("gates", "foam"), None, r"gates.foam: missing, and \[foam\] needs it"),
        (("gates", "foam", "cleaned_share"), 1.2, "less than or equal to 1"),
    ],
)
def test_a_mistake_is_named(place: tuple[str, ...], value: Any, message: str) -> None:
    content = LEVELS["L2"].model_dump(mode="json")
    table = content
    for name in place[:-1]:
        table = table[name]
    table[place[-1]] = value
    with pytest.raises(ValidationError, match=message):
        Protocol.model_validate(content)


def test_foam_needs_the_exams_gates() -> None:
    content = FOAMY.model_dump(mode="json")
    gates = load_protocol("bathing-v3").gates.model_dump(mode="json")
    with pytest.raises(ValidationError, match=r"gates\.set: foam needs the exam's gates, got paper"):
        Protocol.model_validate(content | {"gates": gates | {"foam": content["gates"]["foam"]}})


def test_foam_needs_soft_skin(monkeypatch: pytest.MonkeyPatch) -> None:
    content, abdomen = FOAMY.model_dump(mode="json"), REGIONS["abdomen"]
    monkeypatch.setitem(REGIONS._rows, "shin", Region(segment="right_shank", neighbourhood=abdomen.neighbourhood))
    tasks = [task | {"region": "shin"} if task["id"] == "T6" else task for task in content["tasks"]]
    content["contact"]["neighbourhood"]["shin"] = ["right_shank"]
    with pytest.raises(ValidationError, match=r"foam\.prompts\.T6: the shin is rigid, and foam needs soft skin"):
        Protocol.model_validate(content | {"tasks": tasks})
