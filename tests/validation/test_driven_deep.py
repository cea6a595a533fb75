"""The robot's tool, driven into the abdomen: what the skin holds, and how a tool that goes through is caught."""

from __future__ import annotations

from functools import partial

import pytest

from carecontact.contract.embodiment import EMBODIMENTS
from carecontact.contract.protocol import Protocol
from carecontact.kernel.region import add_region
from carecontact.protocols import load_protocol
from carecontact.validation.driven_deep import Driven, drive
from carecontact.validation.subject import Subject
from carecontact.world.human import tissue

PROTOCOL = load_protocol()


def with_tool(tool: str) -> Protocol:
    return PROTOCOL.model_copy(update={"scene": PROTOCOL.scene.model_copy(update={"tool": tool})})


def missed(driven: Driven) -> list[str]:
    return [
        measure.name.rpartition(": ")[2] for measure in driven.measures() if measure.met is False and measure.decides
    ]


def test_skin_holds_the_cap_until_it_is_pressed_onto_bone() -> None:
    subject = Subject(PROTOCOL)
    driven = drive(subject)
    assert missed(driven) == []
    assert driven.lost_n is None
    assert 0 < driven.sunk < 1
    assert driven.speed_m_s > 0.9 * PROTOCOL.physics.max_tcp_speed_m_s
    assert driven.deepest_m > 0.98 * subject.tissue("abdomen").thickness_m, "it went as deep as there is tissue"


@pytest.fixture
def linear(monkeypatch: pytest.MonkeyPatch, worlds_from_scratch: None) -> None:
    """A contact layer that does not stiffen, and skin that is not let in: a known defect."""
    monkeypatch.setattr(tissue, "add_region", partial(add_region, layer_m=0.0, entry_m=0.0))


@pytest.mark.usefixtures("linear")
def test_a_tool_so_soft_that_the_skin_sinks_past_its_middle_is_a_miss() -> None:
    driven = drive(Subject(with_tool("mitt")))
    assert missed(driven) == ["skin in the tool, over half of its thickness"]
    assert driven.lost_n is not None
    # All of the pad, bearing what sinks the skin to its middle; it is lost before all of the pad does.
    tip = EMBODIMENTS["mitt"].tip
    assert driven.lost_n < 3.1416 * tip.half_m[0] * tip.half_m[1] * tip.half_m[2] / tip.give_m3_n
    assert driven.lost_n > PROTOCOL.limits.gamma * PROTOCOL.limits.f_pain_n["abdomen"], "a trial has failed by then"
