"""The paper's numbers from runs that were built to its counts: made, scored, and read from the tables."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import pytest

from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.reports.paper.build import tables_of
from carecontact.reports.paper.table import Table
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.score import score_recording
from tests.reports.synthetic_run import make_score
from tests.scoring.paper_run import METHODS


@pytest.fixture(scope="module")
def runs() -> list[RunScores]:
    return [
        RunScores(scores=[score_recording(recording, sha256="00" * 32) for recording in make()])
        for make in METHODS.values()
    ]


@pytest.fixture(scope="module")
def tables(runs: list[RunScores]) -> dict[str, Table]:
    return {table.name: table for table in tables_of(runs, load_protocol())}


def pairs(table: Table, ours: str, papers: str) -> list[tuple[str, str]]:
    """Our cell and the paper's of every row, for the first such pair of columns."""
    return [(row[table.head.index(ours)], row[table.head.index(papers)]) for row in table.rows]


def test_all_eight_tables_are_made(tables: dict[str, Table]) -> None:
    assert list(tables) == ["capability", "tasks", "metrics", "protocol", "rates", "scores", "tests", "anatomy"]


def test_the_rates_are_the_printed_ones(tables: dict[str, Table]) -> None:
    rows = tables["rates"].rows
    assert [row[0] for row in rows] == ["State Machine", "VoxPoser", "pi0.5"]
    for row in rows:
        for column in (2, 5, 8):
            assert row[column] == row[column + 1]
    assert rows[0][7:9] == ("79/140", "56.4 (48.2, 64.4)")


def test_the_medians_are_the_printed_ones(tables: dict[str, Table]) -> None:
    table = tables["scores"]
    for ours, papers in (("C1 [N]", "Paper C1"), ("C2 [rad]", "Paper C2"), ("C4", "Paper C4"), ("C5 [N]", "Paper C5")):
        for cell, printed in pairs(table, ours, papers):
            assert cell.partition(" (n=")[0] == printed
    assert [row[1].partition(" ")[2] for row in table.rows] == ["(n=133)", "(n=121)", "(n=30)"]


def test_the_anatomy_is_the_printed_one(tables: dict[str, Table]) -> None:
    table = tables["anatomy"]
    assert len(table.rows) == 9
    for ours in ("Target", "Off-target", "No contact", "C3"):
        assert all(cell == printed for cell, printed in pairs(table, ours, f"Paper: {ours}"))
    assert [row[-1] for row in table.rows] == ["3", "1", "1", "3", "3", "2", "1", "1", "1"]


def test_the_tests_of_rates_are_the_printed_ones(tables: dict[str, Table]) -> None:
    """Those of scores depend on all values, of which the paper prints only medians."""
    rows = {row[0]: row[2:] for row in tables["tests"].rows}
    assert rows["Region-correct"] == ("4.74e-14", "4.74e-14")
    assert rows["Safety-gated"] == ("1.99e-06", "1.99e-06")
    assert len(rows) == 4


def test_a_method_that_is_not_in_the_paper_has_no_printed_values(runs: list[RunScores]) -> None:
    mine = [score.model_copy(update={"policy": "mine_&_50%"}) for score in runs[1].scores]
    tables = {t.name: t for t in tables_of([runs[0], RunScores(scores=mine)], load_protocol())}
    assert tables["rates"].rows[1][0] == "mine_&_50%"
    assert tables["rates"].rows[1][3] == "-"
    assert {row[3] for row in tables["tests"].rows} == {"-"}
    assert r"mine\_\&\_50\% &" in tables["rates"].latex()
    assert list(csv.reader(io.StringIO(tables["rates"].csv())))[2][0] == "mine_&_50%"


def test_one_run_has_no_test_and_an_unknown_protocol_no_rules(runs: list[RunScores]) -> None:
    assert [t.name for t in tables_of(runs[:1], None)] == ["capability", "metrics", "rates", "scores", "anatomy"]


def test_runs_of_two_protocols_stand_in_no_table(runs: list[RunScores]) -> None:
    other = [score.model_copy(update={"protocol_sha256": "11" * 32}) for score in runs[1].scores]
    with pytest.raises(ConfigError, match=r"1 \(state-machine\) ran .* 2 \(voxposer\) ran .*same protocol"):
        tables_of([runs[0], replace(runs[1], scores=other)], None)


def test_latex_takes_both_columns_for_a_wide_table_and_balances_its_environments(tables: dict[str, Table]) -> None:
    for table in tables.values():
        text = table.latex()
        begun = [line.partition("}")[0].removeprefix(r"\begin{") for line in text.splitlines() if r"\begin" in line]
        ended = [line.partition("}")[0].removeprefix(r"\end{") for line in text.splitlines() if r"\end" in line]
        assert begun == ended[::-1]
        assert begun[0] == ("table*" if len(table.head) > 5 else "table")
        assert sum(line.count(" & ") for line in text.splitlines()) == (len(table.rows) + 1) * (len(table.head) - 1)


def test_a_row_of_another_length_than_the_head_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="table x: 1 cells under 2 heads"):
        Table(name="x", caption="", head=("a", "b"), rows=(("1",),))


def test_a_second_run_of_one_method_has_a_name_of_its_own() -> None:
    one = RunScores(scores=[make_score("T1", 0, policy="state-machine")])
    two = RunScores(scores=[make_score("T1", 1, policy="state-machine")])
    rates = next(t for t in tables_of([one, two], None) if t.name == "rates")
    assert [row[0] for row in rates.rows] == ["State Machine", "State Machine (2)"]


def test_a_method_with_five_seeds_has_no_interval() -> None:
    for seeds, enough in ((5, False), (6, True)):
        scores = [make_score(task, seed) for task in ("T1", "T2") for seed in range(seeds)]
        (row,) = next(t for t in tables_of([RunScores(scores=scores)], load_protocol()) if t.name == "rates").rows
        assert row[1] == f"{2 * seeds}/{2 * seeds}"
        assert ("(" in row[2]) is enough
