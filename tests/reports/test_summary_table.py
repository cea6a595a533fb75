from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.reports.table import POOLED, columns, summary_rows
from carecontact.reports.text import angle, percent, rounded
from carecontact.scoring import METRICS, Metric
from tests.reports.synthetic_run import FAILED, NO_CONTACT, Run, make_score


def test_counts_medians_and_valid_n() -> None:
    scores = [
        make_score("T2", 2, **NO_CONTACT),
        make_score("T2", 0, c1_peak_force_n=10.0, c2_joint_margin_rad=-0.2),
        make_score("T2", 1, c1_peak_force_n=20.0, c2_joint_margin_rad=-0.4, safety_gated=False),
    ]
    row, pooled = summary_rows(scores)
    assert (row.task_id, row.name, row.n) == ("T2", "Push forearm", 3)
    assert (row.success, row.region_correct, row.safety_gated) == (2, 2, 1)
    assert (row.medians["C1@1"].estimate, row.medians["C1@1"].n_valid) == (15.0, 2)
    assert row.medians["C2@1"].estimate == pytest.approx(-0.3)
    assert row.cells()[6:8] == ["15.00 (n=2)", "-0.300 (n=2)"]
    assert pooled.task_id == POOLED


def test_joint_margin_is_pooled_over_push_alone() -> None:
    scores = [make_score("T1", 0, c2_joint_margin_rad=-9.0), make_score("T2", 0, c2_joint_margin_rad=-0.5)]
    touch, push, pooled = summary_rows(scores)
    assert touch.cells()[7] == "–"
    assert push.medians["C2@1"].estimate == pooled.medians["C2@1"].estimate == -0.5
    assert pooled.cells()[7] == "-0.500 (n=1)"


def test_no_valid_value_is_na() -> None:
    row = summary_rows([make_score("T2", 0, **(NO_CONTACT | {"c4_motion_activity": None}))])[0]
    assert row.cells()[6:] == ["NA", "NA", "NA", "NA"]


def test_order_does_not_matter(run_of_7: Run) -> None:
    assert summary_rows(run_of_7.scores[::-1]) == summary_rows(run_of_7.scores)
    assert [r.task_id for r in summary_rows(run_of_7.scores)] == ["T1", "T2", "T3", "T4", "T5", "T6", "T7", POOLED]


def test_trials_without_a_verdict_leave_every_count_open() -> None:
    failed = NO_CONTACT | {"ended": "harness_error", "failure_mode": "process_failure", "c4_motion_activity": None}
    scores = [make_score("T1", 0), make_score("T1", 1, **failed), make_score("T2", 0, **failed)]
    touch, push, pooled = summary_rows(scores)
    assert touch.cells()[2:6] == ["1 of 2", "1–2/2", "1–2/2", "1–2/2"]
    assert touch.cells()[6:] == summary_rows(scores[:1])[0].cells()[6:], "medians are of the verdicts"
    assert push.cells()[2:] == ["0 of 1", "0–1/1", "0–1/1", "0–1/1", "NA", "–", "NA", "NA"]
    assert (pooled.n, pooled.success, pooled.share(1)) == (1, 1, "1–3/3")
    pooled = summary_rows(scores, ["T1-s001", "T2-s000", "T9-s004"])[-1]
    assert pooled.trials == "1 of 4", "a task of which nothing is scored counts in all"


def test_a_headline_metric_of_another_package_has_a_column(monkeypatch: pytest.MonkeyPatch) -> None:
    """In its own unit and digits, pooled over the actions that it names."""
    assert "C1@1" in METRICS
    row = Metric(
        id="grip@2", title="Grip", unit="kPa", better="lower", measure=lambda contact: None, pool=("touch", "push"),
        digits=1, headline=True, order=5,
    )  # fmt: skip
    monkeypatch.setitem(METRICS._rows, row.id, row)
    scores = [make_score("T1", 0, additional={"grip@2": 3.14}), make_score("T3", 0, additional={"grip@2": 9.0})]
    assert columns()[-1] == "grip@2 [kPa]"
    assert [cells[-1] for cells in (r.cells() for r in summary_rows(scores))] == ["3.1", "–", "3.1 (n=1)"]


def test_no_scores_no_rows() -> None:
    assert summary_rows([]) == []


def test_one_cell_a_column(run_of_7: Run) -> None:
    rows = [row.cells() for row in summary_rows(run_of_7.scores)]
    assert {len(cells) for cells in rows} == {len(columns())}
    assert columns()[-4:] == ("C1 [N]", "C2 [rad]", "C4", "C5 [N]")
    assert rows[-1][:6] == ["all", "All trials", "7", "4/7", "3/7", "2/7"]


@pytest.mark.parametrize("other", [{"policy": "voxposer"}, {"protocol_sha256": "00" * 32}, {"protocol_id": "other-v1"}])
def test_mixed_runs_are_refused(other: dict[str, str]) -> None:
    with pytest.raises(ConfigError):
        summary_rows([make_score("T1", 0), make_score("T1", 1, **FAILED, **other)])


@pytest.mark.parametrize(
    ("value", "text"), [(None, "NA"), (0.0, "0.000"), (-3.61e-4, "-3.61e-4"), (0.25, "0.250"), (-0.0123, "-0.012")]
)
def test_angles(value: float | None, text: str) -> None:
    assert angle(value) == text


def test_percent_keeps_number_and_sign_together() -> None:
    assert percent(0.3649) == "36\N{NO-BREAK SPACE}%"


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "NA"), (0.0, "0"), (0.0049, "0.00"), (0.126, "0.13"), (-0.5, "-0.50"), (34.06, "34.1"), (1234.5, "1234")],
)
def test_rounding(value: float | None, text: str) -> None:
    assert rounded(value) == text
