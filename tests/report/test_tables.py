from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pyarrow as arrow  # pyright: ignore[reportMissingTypeStubs]
import pyarrow.parquet as parquet  # pyright: ignore[reportMissingTypeStubs]
import pytest

from carecontact.cli.publish import write_table
from carecontact.errors import ConfigError, DependencyError
from carecontact.report.tables import POOLED, columns, limit_rows, load, summary_rows
from carecontact.report.trial_table import TABLE_NAME, metric_column, trial_table, write_trial_table
from carecontact.report.trial_table import columns as trial_table_columns
from carecontact.report.words import angle, percent, rounded
from carecontact.scoring import METRICS, Metric
from carecontact.scoring.limits import UNCHECKED
from tests.report.synthetic import FAILED, NO_CONTACT, Run, make_score


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
    rows = load(scores, every=True).rows
    assert [row.metric.id for row in rows] == ["C1@1", "C2@1", "C4@1", "C5@1", "impulse@1"]
    assert rows[0].cells((1, 1)) == ["12.30", "12.30"]


def test_details_and_metrics_without_any_value_have_a_row_only_in_the_full_table() -> None:
    additional = {"impulse@1": 10.0, "shear_work@1": -0.0004, "foam_place@1": None}
    scores = [make_score("T1", 0, additional=additional)]
    assert [row.metric.id for row in load(scores).rows] == ["impulse@1"]
    assert set(additional) <= {row.metric.id for row in load(scores, every=True).rows}


def test_nothing_without_further_metrics() -> None:
    assert load([make_score("T1", 0)]).rows == ()
    assert load([]).contacts == (0,)


def test_metres_and_joules_are_shown_in_thousandths() -> None:
    scores = [make_score("T3", 0, additional={"knock_energy@1": 0.0041, "shear_work@1": 0.7})]
    rows = {row.metric.id: row for row in load(scores, every=True).rows if row.metric.unit == "J"}
    assert rows["knock_energy@1"].label == "knock_energy@1 [mJ]"
    assert [row.cells((1, 1))[0] for row in rows.values()] == ["4.10", "700"]


PAGE = (Path(__file__).parents[2] / "docs" / "scores.md").read_text()
FURTHER = {id_: 0.5 for id_ in METRICS if id_ not in ("C1@1", "C2@1", "C3@1", "C4@1", "C5@1")}


def test_one_row_a_trial_with_its_types(tmp_path: Path) -> None:
    scores = [
        make_score("T6", 0, **NO_CONTACT, failure_mode="no_target_contact", additional={"impulse@1": None}),
        make_score("T1", 1, **FAILED, ended="harness_error", additional={"impulse@1": 1.5}),
        make_score("T1", 0, additional={"impulse@1": 12.5, "mine@2": 3.0}),
    ]
    path = write_trial_table(tmp_path, scores)
    assert [p.name for p in tmp_path.iterdir()] == [TABLE_NAME]
    table = parquet.read_table(path)
    rows = table.to_pylist()
    assert [r["trial_id"] for r in rows] == ["T1-s000", "T1-s001", "T6-s000"]
    first, harness, untouched = rows
    assert (first["c1_peak_force_n"], first["c3_success"], first["reversals"]) == (12.3, True, 2)
    assert (first["metric_impulse_v1_ns"], first["metric_mine_v2"], first["mujoco_version"]) == (12.5, 3.0, "4.0.0")
    assert (harness["is_judged"], first["is_judged"]) == (False, True)
    assert untouched["c1_peak_force_n"] is untouched["metric_impulse_v1_ns"] is untouched["metric_mine_v2"] is None
    assert untouched["failure_mode"] == "no_target_contact"
    kinds = {field.name: str(field.type) for field in table.schema}
    assert (kinds["seed"], kinds["c2_joint_margin_rad"], kinds["safety_gated"]) == ("int64", "double", "bool")
    assert kinds["evidence"] == "string", "null in every row, and still no null type"


def test_the_table_is_the_one_that_pyarrow_makes_of_the_same_values(tmp_path: Path) -> None:
    """In groups of nine, so that the bitmaps of what is null end within a byte."""
    scores = [
        make_score("T1", seed, **(FAILED if seed % 3 else {}), policy="Größe", additional={"impulse@1": value})
        for seed, value in enumerate([1.5, None, float("inf"), -0.0, 1e-300, None, 7.0, 2.0, 3.0])
    ]
    arrow_types = {str: arrow.string(), float: arrow.float64(), int: arrow.int64(), bool: arrow.bool_()}
    made = trial_table(scores)
    for column in trial_table_columns(scores):
        wanted = arrow.array([column.value(s) for s in scores], type=arrow_types[column.kind])
        assert made[column.name].combine_chunks().equals(wanted), column.name
        assert made[column.name].null_count == wanted.null_count
    made.validate(full=True)


def test_the_table_is_written_without_pandas(tmp_path: Path) -> None:
    code = (
        "import sys; from carecontact.report.trial_table import write_trial_table; "
        f"write_trial_table({str(tmp_path)!r}, []); assert 'pyarrow' in sys.modules; assert 'pandas' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_a_trial_the_columns_stay(tmp_path: Path) -> None:
    table = parquet.read_table(write_trial_table(tmp_path, []))
    assert (table.num_rows, table.column_names) == (0, [c.name for c in trial_table_columns([])])


def test_every_column_is_in_the_docs_and_no_other() -> None:
    section = PAGE.partition("## The table")[2].partition("\n## ")[0]
    wording = set(re.findall(r"`([a-z0-9_]+)`", section.partition("\n|")[2]))
    assert wording == {c.name for c in trial_table_columns([make_score("T1", 0, additional=FURTHER)])}


@pytest.mark.parametrize(
    ("id_", "name"),
    [("force_rate_p95@1", "metric_force_rate_p95_v1_n_s"), ("shear_work@1", "metric_shear_work_v1_j"),
     ("unknown@3", "metric_unknown_v3"), ("plain", "metric_plain_v0")],
)  # fmt: skip
def test_columns_of_metrics_say_version_and_unit(id_: str, name: str) -> None:
    assert metric_column(id_) == name


def test_without_pyarrow_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(DependencyError, match=r"pip install 'carecontact\[tables\]'"):
        write_trial_table(tmp_path, [make_score("T1", 0)])
    assert list(tmp_path.iterdir()) == []
    assert write_table(tmp_path, []) == "no table: the table of trials needs pyarrow: pip install 'carecontact[tables]'"
    (tmp_path / TABLE_NAME).write_bytes(b"old")
    assert write_table(tmp_path, []).endswith("; the existing results.parquet comes from an earlier scoring")
