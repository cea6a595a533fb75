"""How often the person was touched in a trial that made too little progress."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.reports.trial.words import mode_text
from carecontact.scoring.contact import find_contact
from carecontact.scoring.gate import GatePart
from tests.reports.synthetic_run import FAILED, make_recording, make_score, plateau


@pytest.mark.parametrize(
    ("starts", "told"), [((1,), "touched without interruption for "), ((1, 3, 5), "touched 3 times, for ")]
)
def test_contact_is_only_said_to_hold_where_it_did(starts: tuple[int, ...], told: str) -> None:
    time_s = (np.arange(4000) + 1) * 0.002
    force = np.sum([plateau(time_s, start=start, end=start + 1, level=5, ripple=0) for start in starts], axis=0)
    contact = find_contact(make_recording("T1", 0, {"right_forearm": force}, duration_s=8))
    score = make_score("T1", 0, **FAILED | {"failure_mode": "insufficient_progress"})
    gate = GatePart(name="On", needed="70%", reached="69%", met=False)
    said = mode_text(score, contact, [gate])
    assert said.startswith(told)
    assert said.endswith("the trial missed 1 gate, namely “On”: 69\N{NO-BREAK SPACE}%, 70\N{NO-BREAK SPACE}% needed")
