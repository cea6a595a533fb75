"""What a cause was in one trial, from the evidence that is kept with its score."""

from __future__ import annotations

import pytest

from carecontact.reports.cause_words import cause_text
from carecontact.reports.failures import causes
from carecontact.scoring.result import TrialScore
from tests.reports.synthetic_run import FAILED, make_score


def failed(cause: str, mode: str, evidence: str, *, seed: int = 0) -> TrialScore:
    return make_score("T1", seed, **FAILED | {"failure_mode": mode, "attribution": cause, "evidence": evidence})


@pytest.mark.parametrize(
    ("cause", "mode", "evidence", "told"),
    [
        ("planning", "no_target_contact", "No motion was commanded; the policy asked for no images.", "no motion"),
        ("planning", "no_target_contact", "The commanded path was aimed 159 mm beside the forearm; it saw it.",
         "a path beside the named region"),
        ("planning", "no_target_contact",
         "The commanded path came to 12 mm above the surface of the forearm; the robot touched nothing.",
         "stayed off the surface"),
        ("planning", "insufficient_progress", "The commanded path came to 11 mm above the surface of the forearm, but",
         "the tool touched the person, but the policy commanded a path that stayed off"),
        ("planning", "lost_contact", "Contact was lost once, 0 of them while", "left the skin"),
        ("planning", "insufficient_progress", "The commanded path came to 8 mm below", "could not pass the gate"),
        ("perception", "no_target_contact", "No motion was commanded; the forearm was in view", "no motion"),
        ("execution", "lost_contact", "Contact was lost twice", "contact was lost"),
        ("execution", "insufficient_progress", "The commanded path came to", "fell short"),
        ("safety", "safety_truncation", "The trial was cut by the solver (x) at", "the solver failed"),
        ("safety", "safety_truncation", "The trial was cut at 201.0 N on the chest", "a force exceeded"),
        ("safety", "joint_beyond_range", "The elbow was 0.1 rad beyond", "a joint of the person"),
    ],
)  # fmt: skip
def test_one_thing_is_said_and_no_alternative(cause: str, mode: str, evidence: str, told: str) -> None:
    said = cause_text(failed(cause, mode, evidence))
    assert told in said
    assert " or " not in said


def test_the_table_of_causes_has_a_row_for_each_thing_that_happened() -> None:
    still, beside = "No motion was commanded; it saw nothing.", "The commanded path was aimed 90 mm beside the forearm."
    scores = [failed("planning", "no_target_contact", still)]
    scores += [failed("planning", "no_target_contact", beside, seed=seed) for seed in (1, 2)]
    assert [(row.name, row.count) for row in causes(scores)] == [("planning", 2), ("planning", 1)]
    assert [row.meaning.split()[-1] for row in causes(scores)] == ["region", "motion"]
