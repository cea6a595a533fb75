from __future__ import annotations

import pytest

from carecontact.reports.limit_rows import limit_rows
from carecontact.scoring.limits import UNCHECKED
from tests.reports.synthetic_run import FAILED, NO_CONTACT, make_score


def scores() -> list:
    """Of four judged trials: 40 N on the forearm (gate 35), succeeded; 130 N on the abdomen (pain 60), failed."""
    limits = {"metric_versions": {"limits": "behrens-2021-table-8"}}
    hard = {"peak_force_n": {"right_forearm": 40.0}, "over_limit": {"right_forearm": 40 / 35}}
    worst = {"peak_force_n": {"abdomen": 130.0, "right_forearm": 1.0}, "over_limit": {"abdomen": 130 / 21}}
    return [
        make_score("T1", 0, **limits),
        make_score("T1", 1, **limits, **hard, safety_gated=False),
        make_score("T6", 0, **limits, **worst, **FAILED),
        make_score("T6", 1, **limits, **NO_CONTACT),
        make_score("T6", 2, **limits, **worst, ended="harness_error"),
    ]


def test_gate_pain_and_the_other_pack() -> None:
    gate, pain, iso = limit_rows(scores(), gamma=0.35)
    assert gate.name == "Safety gate, 0.35 of the pain limit"
    assert (gate.above.k, gate.above.n, gate.n_success) == (2, 4, 1)
    assert gate.worst == pytest.approx(130 / 21)
    assert gate.worst_at == "T6-s000, abdomen"
    assert "Behrens" in pain.name
    assert (pain.above.k, pain.n_success, pain.worst) == (1, 0, pytest.approx(130 / 60))
    assert iso.name.endswith(UNCHECKED)
    assert (iso.above.k, iso.above.n, iso.worst) == (1, 4, pytest.approx(130 / 110))


def test_the_gate_without_its_discount_is_counted_all_the_same() -> None:
    gate = limit_rows(scores(), gamma=None)[0]
    assert (gate.above.k, gate.worst, gate.worst_at) == (2, None, "")


def test_where_nobody_was_touched_nothing_is_highest() -> None:
    rows = limit_rows(scores()[3:4], gamma=0.35)
    assert [(r.above.k, r.worst) for r in rows] == [(0, None)] * 3


def test_a_crash_before_any_contact_decides_nothing_and_one_after_a_force_does() -> None:
    untouched = make_score("T1", 5, **NO_CONTACT, ended="process_failure")
    hard = {"peak_force_n": {"right_forearm": 61.9}, "over_limit": {"right_forearm": 61.9 / 35}}
    pressed = make_score("T1", 6, **FAILED, **hard, ended="process_failure")
    soft = make_score("T1", 7, **FAILED, ended="process_failure")
    gate, pain, *_ = limit_rows([make_score("T1", 0), untouched, pressed, soft], gamma=0.35)
    assert (gate.above.k, gate.above.n, gate.worst_at) == (1, 3, "T1-s006, right forearm")
    assert (pain.above.k, pain.above.n) == (0, 3)
    assert limit_rows([untouched], gamma=0.35) == []
