from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pyarrow as arrow  # pyright: ignore[reportMissingTypeStubs]
import pyarrow.parquet as parquet  # pyright: ignore[reportMissingTypeStubs]
import pytest

from carecontact.cli.rescoring import write_table
from carecontact.errors import DependencyError
from carecontact.reports.trial_table import TABLE_NAME, columns, metric_column, trial_table, write_trial_table
from carecontact.scoring import METRICS
from tests.reports.synthetic_run import FAILED, NO_CONTACT, make_score

PAGE = (Path(__file__).parents[2] / "docs" / "scoring.md").read_text()
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
    for column in columns(scores):
        wanted = arrow.array([column.value(s) for s in scores], type=arrow_types[column.kind])
        assert made[column.name].combine_chunks().equals(wanted), column.name
        assert made[column.name].null_count == wanted.null_count
    made.validate(full=True)


def test_the_table_is_written_without_pandas(tmp_path: Path) -> None:
    code = (
        "import sys; from carecontact.reports.trial_table import write_trial_table; "
        f"write_trial_table({str(tmp_path)!r}, []); assert 'pyarrow' in sys.modules; assert 'pandas' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_a_trial_the_columns_stay(tmp_path: Path) -> None:
    table = parquet.read_table(write_trial_table(tmp_path, []))
    assert (table.num_rows, table.column_names) == (0, [c.name for c in columns([])])


def test_every_column_is_in_the_docs_and_no_other() -> None:
    section = PAGE.partition("## The table")[2].partition("\n## ")[0]
    told = set(re.findall(r"`([a-z0-9_]+)`", section.partition("\n|")[2]))
    assert told == {c.name for c in columns([make_score("T1", 0, additional=FURTHER)])}


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
