from __future__ import annotations

from typing import get_args

from carecontact.reports.cause_words import cause_text
from carecontact.reports.failures import EXAMPLES, MODE_MEANING, anatomy, causes, failure_modes
from carecontact.scoring import Attribution, FailureMode
from tests.reports.synthetic_run import FAILED, NO_CONTACT, make_score


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
        ("lost contact", 2, 3), ("no target contact", 1, 3)
    ]  # fmt: skip


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
    rows = {r.region: (r.n, r.target, r.off_target, r.none, r.process_failure, r.success) for r in anatomy(scores)}
    assert rows == {
        "forearm": (2, 1, 1, 0, 0, 1), "upper arm": (1, 0, 0, 1, 0, 0), "abdomen": (1, 0, 0, 0, 1, 0),
        "all": (4, 1, 1, 1, 1, 1),
    }  # fmt: skip
    assert [r.region for r in anatomy(scores[:2])] == ["forearm"]
