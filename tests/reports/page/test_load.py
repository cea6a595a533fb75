from __future__ import annotations

import pytest

from carecontact.reports.page.load import FIRST, load, rounded
from carecontact.scoring import METRICS
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
    assert (impulse.id, impulse.title, impulse.unit) == ("impulse@1", "Impulse", "N s")
    assert impulse.cells(found.contacts) == ["20.0", "5.00", "10.0"]
    assert (other.title, other.unit) == ("other@1", "")
    assert other.cells(found.contacts) == ["1.00 (n=1)", "NA", "1.00 (n=1)"]


def test_every_metric_of_this_package_has_its_place() -> None:
    own = {id_ for id_, metric in METRICS.items() if metric.compute.__module__.startswith("carecontact.")}
    assert set(FIRST) == own - {"C1@1", "C2@1", "C3@1", "C4@1", "C5@1"}


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "NA"), (0.0, "0"), (0.0049, "0.00"), (0.126, "0.13"), (-0.5, "-0.50"), (34.06, "34.1"), (1234.5, "1234")],
)
def test_rounding(value: float | None, text: str) -> None:
    assert rounded(value) == text


def test_nothing_without_further_metrics() -> None:
    assert load([make_score("T1", 0)]).rows == ()
    assert load([]).contacts == (0,)
