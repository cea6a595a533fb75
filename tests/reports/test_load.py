from __future__ import annotations

from carecontact.reports.load import load
from tests.reports.synthetic_run import NO_CONTACT, make_score


def test_medians_by_task_and_over_all() -> None:
    scores = [
        make_score("T1", 0, additional={"impulse@1": 10.0, "other@1": 1.0}),
        make_score("T1", 1, additional={"impulse@1": 30.0, "other@1": None}),
        make_score("T6", 0, additional={"impulse@1": 5.0, "other@1": None}),
        make_score("T6", 1, **NO_CONTACT, additional={"impulse@1": None, "other@1": None}),
        make_score("T6", 2, additional={"impulse@1": 900.0, "other@1": 4.0}, ended="harness_error"),
    ]
    found = load(scores)
    assert (found.tasks, found.n, found.contacts) == (("T1", "T6"), (2, 2, 4), (2, 1, 3))
    impulse, other = found.rows
    assert (impulse.metric.id, impulse.metric.title, impulse.unit) == ("impulse@1", "Impulse", "N s")
    assert impulse.cells(found.contacts) == ["20.0", "5.00", "10.0"]
    assert (other.metric.title, other.unit) == ("other@1", "")
    assert other.cells(found.contacts) == ["1.00 (n=1)", "NA", "1.00 (n=1)"]


def test_headlines_stand_first_where_they_are_wanted() -> None:
    scores = [make_score("T2", 0, additional={"impulse@1": 10.0})]
    assert [row.metric.id for row in load(scores).rows] == ["impulse@1"]
    rows = load(scores, headlines=True).rows
    assert [row.metric.id for row in rows] == ["C1@1", "C2@1", "C4@1", "C5@1", "impulse@1"]
    assert rows[0].cells((1, 1)) == ["12.30", "12.30"]


def test_nothing_without_further_metrics() -> None:
    assert load([make_score("T1", 0)]).rows == ()
    assert load([]).contacts == (0,)


def test_metres_and_joules_are_shown_in_thousandths() -> None:
    scores = [make_score("T3", 0, additional={"knock_energy@1": 0.0041, "shear_work@1": 0.7})]
    rows = {row.metric.id: row for row in load(scores).rows}
    assert rows["knock_energy@1"].label == "knock_energy@1 [mJ]"
    assert [row.cells((1, 1))[0] for row in rows.values()] == ["4.10", "700"]
