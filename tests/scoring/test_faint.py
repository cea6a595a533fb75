"""What is said of a press that does not count as contact."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.protocol import Protocol
from carecontact.recording import Recording
from carecontact.scoring import score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.faint import faint_press
from tests.scoring.synthetic import PROTOCOL, SIZE, hold, make_recording, touch


def pressed(force: float, seconds: float, *, on_n: float = 0.5, segment: str = "right_forearm") -> Recording:
    contact = PROTOCOL.contact.model_copy(update={"on_n": on_n})
    protocol: Protocol = PROTOCOL.model_copy(update={"contact": contact})
    at = (0.0, 0.0, SIZE["forearm"][2] + 0.005)
    return make_recording(
        "T1", duration=4.0, normal={segment: hold(4.0, 1.0, 1.0 + seconds, force)}, protocol=protocol,
        targets_in_region=[(0.1, at)],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        (pressed(0.3, 1.7), "pressed the right forearm for 1.7 s with at most 0.3 N; contact counts from 0.5 N"),
        (pressed(0.7, 0.5, on_n=0.8), "pressed the right forearm for 0.5 s with at most 0.7 N; contact counts from"),
        (pressed(0.02, 0.1), "pressed the right forearm for 0.1 s with less than 0.05 N; contact counts"),
        (pressed(0.4, 1.0, segment="abdomen"), "pressed the abdomen for 1.0 s with at most 0.4 N; contact counts"),
    ],
)  # fmt: skip
def test_a_press_below_the_threshold_is_told_with_it(recording: Recording, said: str) -> None:
    assert (faint_press(find_contact(recording)) or "").startswith(said)


def test_a_contact_that_is_too_brief_is_told_with_its_time() -> None:
    contact = find_contact(pressed(30.0, 0.01))
    assert contact.reported is not None
    assert not contact.valid
    told = faint_press(contact) or ""
    assert told.startswith("pressed the right forearm for 0.01 s with at most 30.0 N, of which 0.0")
    assert told.endswith("count as contact (from 0.5 N); a trial needs 0.05 s of it")


def test_nothing_is_said_of_no_press_and_of_contact_that_counts() -> None:
    assert faint_press(find_contact(make_recording())) is None
    assert faint_press(find_contact(touch())) is None


def test_the_evidence_of_a_faint_press_does_not_say_that_nothing_was_touched() -> None:
    score = score_recording(pressed(0.3, 1.7))
    assert score.failure_mode == "no_target_contact"
    assert score.evidence.endswith(
        "the robot pressed the right forearm for 1.7 s with at most 0.3 N; contact counts from 0.5 N."
    )
    untouched = score_recording(pressed(0.0, 1.7))
    assert (untouched.evidence or "").endswith("the robot touched nothing.")
    assert np.isclose(find_contact(pressed(0.3, 1.7)).force_norm.max(), 0.3, rtol=1e-3)
