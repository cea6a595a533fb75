from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from carecontact.report.failures import (
    EXAMPLES,
    MODE_MEANING,
    anatomy,
    cause_text,
    causes,
    evidence_text,
    failure_modes,
    off_surface,
)
from carecontact.report.trial_page import mode_text
from carecontact.scoring import Attribution, FailureMode
from carecontact.scoring.behaviour import GatePart
from carecontact.scoring.contact import find_contact
from carecontact.scoring.result import TrialScore
from tests.report.synthetic import FAILED, NO_CONTACT, make_recording, make_score, plateau


def failed(task_id: str, seed: int, cause: str, evidence: str, **changes: object):
    row = FAILED | {"failure_mode": "lost_contact", "attribution": cause, "evidence": evidence} | changes
    return make_score(task_id, seed, **row)


def test_every_mode_and_cause_is_explained() -> None:
    assert set(MODE_MEANING) == set(get_args(FailureMode))
    assert all(cause_text(failed("T1", 0, cause, "")) for cause in get_args(Attribution))


def test_denominator_of_modes_is_the_failures() -> None:
    scores = [
        make_score("T1", 0),
        failed("T1", 1, "planning", "a"),
        failed("T1", 2, "execution", "b"),
        failed("T6", 0, "perception", "c", failure_mode="no_target_contact"),
        failed("T6", 1, "process", "d", ended="harness_error", failure_mode="process_failure"),
    ]
    assert [(m["mode"], m["count"], m["of"]) for m in failure_modes(scores)] == [
        ("lost contact", 2, 3),
        ("no target contact", 1, 3),
    ]


def test_evidence_is_taken_from_different_tasks_first() -> None:
    scores = [failed("T1", seed, "planning", f"forearm {seed}") for seed in range(3)]
    scores += [failed("T7", 4, "planning", "belly"), failed("T3", 0, "execution", "slipped")]
    first, second = causes(scores)
    assert (first.name, first.count, second.name, second.count) == ("planning", 4, "execution", 1)
    assert first.examples == (("T1-s000", "forearm 0"), ("T7-s004", "belly"))
    assert len(first.examples) == EXAMPLES
    assert second.examples == (("T3-s000", "slipped"),)


def test_anatomy_partitions_each_region() -> None:
    scores = [
        make_score("T1", 0),
        make_score("T2", 0, **FAILED, anatomy="off_target"),
        make_score("T4", 0, **NO_CONTACT),
        make_score("T6", 0, **(NO_CONTACT | {"anatomy": "process_failure"})),
        make_score("T6", 1, ended="harness_error"),
    ]
    kinds = ("n", "target", "off_target", "none", "process_failure", "success")
    rows = {r["region"]: tuple(r[kind] for kind in kinds) for r in anatomy(scores)}
    assert rows == {
        "forearm": (2, 1, 1, 0, 0, 1), "upper arm": (1, 0, 0, 1, 0, 0), "abdomen": (1, 0, 0, 0, 1, 0),
        "all": (4, 1, 1, 1, 1, 1),
    }  # fmt: skip
    assert [r["region"] for r in anatomy(scores[:2])] == ["forearm"]


# What a cause was in one trial, from the evidence that is kept with its score.


def failed_by(cause: str, mode: str, evidence: str, *, seed: int = 0) -> TrialScore:
    return make_score("T1", seed, **FAILED | {"failure_mode": mode, "attribution": cause, "evidence": evidence})


@pytest.mark.parametrize(
    ("cause", "mode", "evidence", "wording"),
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
def test_one_cause_is_given_and_no_alternative(cause: str, mode: str, evidence: str, wording: str) -> None:
    sentence = cause_text(failed_by(cause, mode, evidence))
    assert wording in sentence
    assert " or " not in sentence


def test_the_table_of_causes_has_a_row_for_each_thing_that_happened() -> None:
    still, beside = "No motion was commanded; it saw nothing.", "The commanded path was aimed 90 mm beside the forearm."
    scores = [failed_by("planning", "no_target_contact", still)]
    scores += [failed_by("planning", "no_target_contact", beside, seed=seed) for seed in (1, 2)]
    assert [(row.name, row.count) for row in causes(scores)] == [("planning", 2), ("planning", 1)]
    assert [row.meaning.split()[-1] for row in causes(scores)] == ["region", "motion"]


# Kept evidence, as pages word it.

NBSP = "\N{NO-BREAK SPACE}"


def worded(evidence: str | None) -> str:
    return evidence_text(make_score("T1", 0, **FAILED | {"evidence": evidence}))


def test_a_distance_to_the_surface_is_not_called_upward() -> None:
    kept = "The commanded path came to 28 mm above the surface of the forearm; the robot touched right_thigh, head."
    sentence = (
        "The commanded path came to within 28 mm of the surface of the forearm; the robot touched right thigh, head."
    )
    assert worded(kept) == sentence
    assert off_surface(make_score("T1", 0, **FAILED | {"evidence": kept}))
    assert "came to 5 mm below the surface" in worded("The commanded path came to 5 mm below the surface of the arm.")


def test_shares_have_one_spacing() -> None:
    assert worded("and was on for 100% of 70%.") == f"and was on for 100{NBSP}% of the time, 70{NBSP}% needed."
    assert worded("69% of the sliding") == f"69{NBSP}% of the sliding"


def test_what_the_policy_noted_stays() -> None:
    kept = 'the policy noted "move_to right_thigh at 50%" and no target'
    assert worded(kept) == kept
    assert worded(None) == ""


# How often the person was touched in a trial that made too little progress.


@pytest.mark.parametrize(
    ("starts", "wording"), [((1,), "touched without interruption for "), ((1, 3, 5), "touched 3 times, for ")]
)
def test_contact_only_holds_where_it_did(starts: tuple[int, ...], wording: str) -> None:
    time_s = (np.arange(4000) + 1) * 0.002
    force = np.sum([plateau(time_s, start=start, end=start + 1, level=5, ripple=0) for start in starts], axis=0)
    contact = find_contact(make_recording("T1", 0, {"right_forearm": force}, duration_s=8))
    score = make_score("T1", 0, **FAILED | {"failure_mode": "insufficient_progress"})
    gate = GatePart(name="On", needed="70%", reached="69%", met=False)
    sentence = mode_text(score, contact, [gate])
    assert sentence.startswith(wording)
    assert sentence.endswith(
        "the trial missed 1 gate, namely “On”: 69\N{NO-BREAK SPACE}%, 70\N{NO-BREAK SPACE}% needed"
    )
