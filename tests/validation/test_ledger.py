"""The ledger of tools that touch the skin: what a wrong kernel would show, and where the energy goes."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.validation.ledger import Ledger, contact
from carecontact.validation.rig import CAP, PAD
from carecontact.validation.subject import Subject


def test_shares_are_of_what_was_put_in() -> None:
    found = Ledger(began=1.0, put_in=2.0, left=0.3, lost=0.6, held=np.array([1.0, 0.4, 0.5, 0.3]))
    assert found.unexplained == pytest.approx(0.05)
    assert found.gain == pytest.approx(0.05)


def test_half_the_energy_of_a_bounce_is_somewhere_on_the_way(subject: Subject) -> None:
    """The line is not met because nothing happens: most of what the tool brings is lost in the tissue."""
    found = contact(subject, "forearm", CAP, "bounced", dt_s=0.002)
    assert found.began == pytest.approx(0.5 * 0.2**2)
    assert 0.2 * found.began < found.lost < 0.95 * found.began
    assert abs(found.unexplained) < 0.02
    assert found.gain < 0.01


def test_a_sharp_rim_with_little_friction_makes_no_energy(subject: Subject) -> None:
    """The pad's rim is rounded with 2 mm. Where the gap beside it was no distance, dragging it gained 9 %."""
    slippery = subject.tissue("abdomen").model_copy(update={"friction": 0.01})
    found = contact(subject.with_tissue("abdomen", slippery), "abdomen", PAD, "dragged", dt_s=0.001)
    assert abs(found.unexplained) < 0.02
    assert found.gain < 0.01
