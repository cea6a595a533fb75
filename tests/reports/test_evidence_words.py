"""Kept evidence, as pages word it."""

from __future__ import annotations

from carecontact.reports.evidence_words import evidence_text, off_surface
from tests.reports.synthetic_run import FAILED, make_score

NBSP = "\N{NO-BREAK SPACE}"


def worded(evidence: str | None) -> str:
    return evidence_text(make_score("T1", 0, **FAILED | {"evidence": evidence}))


def test_a_distance_to_the_surface_is_not_said_to_be_upward() -> None:
    kept = "The commanded path came to 28 mm above the surface of the forearm; the robot touched right_thigh, head."
    said = "The commanded path came to within 28 mm of the surface of the forearm; the robot touched right thigh, head."
    assert worded(kept) == said
    assert off_surface(make_score("T1", 0, **FAILED | {"evidence": kept}))
    assert "came to 5 mm below the surface" in worded("The commanded path came to 5 mm below the surface of the arm.")


def test_shares_have_one_spacing() -> None:
    assert worded("and was on for 100% of 70%.") == f"and was on for 100{NBSP}% of the time, 70{NBSP}% needed."
    assert worded("69% of the sliding") == f"69{NBSP}% of the sliding"


def test_what_the_policy_noted_stays() -> None:
    kept = 'the policy noted "move_to right_thigh at 50%" and no target'
    assert worded(kept) == kept
    assert worded(None) == ""
