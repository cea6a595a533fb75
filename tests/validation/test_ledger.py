"""The ledger of tools that touch the skin: what a wrong kernel would show, and where the energy goes."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from carecontact.kernel.region import add_region
from carecontact.validation import energy_made, ledger
from carecontact.validation.ledger import Ledger, bounce, drag
from carecontact.validation.rig import CAP, PAD
from carecontact.validation.subject import Subject
from carecontact.world.human import tissue

from .defects import ActsInContactOnly, driven


def test_shares_are_of_what_was_put_in() -> None:
    found = Ledger(put_in=2.0, lost=0.6, balance=np.array([0.0, -0.2, 0.04, -0.1]))
    assert found.unexplained == pytest.approx(0.05)
    assert found.gain == pytest.approx(0.02)
    assert found.rise == pytest.approx(0.12)


@pytest.fixture
def linear(monkeypatch: pytest.MonkeyPatch, worlds_from_scratch: None) -> None:
    """A contact layer that does not stiffen, and skin that is not let in: a known defect."""
    monkeypatch.setattr(tissue, "add_region", partial(add_region, layer_m=0.0, entry_m=0.0))


@pytest.mark.usefixtures("linear")
def test_energy_that_is_made_and_lost_again_counts(subject: Subject) -> None:
    """What dampers and friction take hides it from a sum of what tool and tissue hold: that only falls here."""
    found = drag(subject, "abdomen", PAD, press_n=7.0, speed_m_s=0.1, dt_s=0.002)
    assert found.gain > 0.02
    assert {m.name.rpartition(": ")[2]: m.met for m in found.measures("pad") if m.met is not None} == {
        "energy that is not accounted for, of that put in": False,
        "most energy made until any instant, of that put in": False,
    }


def test_dampers_that_drive_are_found(subject: Subject) -> None:
    """A kernel with the wrong sign on its damper books the energy that it makes as a negative loss."""
    found = bounce(ActsInContactOnly(subject, driven), "forearm", CAP, speed_m_s=0.2, dt_s=0.002)
    assert found.gain > ledger.GAIN_PERCENT / 100


@pytest.mark.usefixtures("linear")
def test_contacts_beyond_the_claim_are_reported_and_do_not_decide(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = [hard for hard in energy_made.HARD if hard.how == "pressed with 7 N and dragged at 0.1 m/s"]
    monkeypatch.setattr(energy_made, "HARD", known)
    measures = list(energy_made.measures(subject, "abdomen"))
    assert {m.name for m in measures if m.met is False} >= {
        "abdomen, beyond the claim: pad of 1 kg pressed with 7 N and dragged at 0.1 m/s at 2 ms: "
        "most energy made until any instant, of that put in"
    }
    assert not any(m.decides for m in measures if m.limit is not None)


def test_half_the_energy_of_a_bounce_is_somewhere_on_the_way(subject: Subject) -> None:
    """The line is not met because nothing happens: most of what the tool brings is lost in the tissue."""
    found = bounce(subject, "forearm", CAP, speed_m_s=0.2, dt_s=0.002)
    assert found.put_in == pytest.approx(0.5 * 0.2**2)
    assert 0.2 * found.put_in < found.lost < 0.95 * found.put_in
    assert abs(found.unexplained) < 0.02
    assert found.gain < 0.01


def test_a_sharp_rim_with_little_friction_makes_no_energy(subject: Subject) -> None:
    """The pad's rim is rounded with 2 mm. Where the gap beside it was no distance, dragging it gained 9 %."""
    slippery = subject.tissue("abdomen").model_copy(update={"friction": 0.01})
    found = drag(subject.with_tissue("abdomen", slippery), "abdomen", PAD, press_n=3.0, speed_m_s=0.1, dt_s=0.001)
    assert abs(found.unexplained) < 0.02
    assert found.gain < 0.01


def test_the_robot_s_own_tool_is_dragged_hard_and_pulled_slowly() -> None:
    tools = [hard.tool.name for hard in ledger.of_the_layer("abdomen", energy_made.MITT)]
    assert tools == ["mitt", "pad", "mitt"]
