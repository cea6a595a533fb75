"""The paper's numbers from runs that were built to its counts: made, scored, and read from the tables."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carecontact.errors import ConfigError
from carecontact.protocol.load import load_protocol
from carecontact.recording import Recording, read_recording
from carecontact.report import paper_figures
from carecontact.report.paper import one_of_each_task, tables_of
from carecontact.report.paper_method import Method, Table, methods_of, read_paper
from carecontact.runs import score_run
from carecontact.runs.pooling import RunScores
from carecontact.scoring.score import score_recording
from carecontact.stats import wilson_interval
from tests.report.synthetic import FAILED, make_score
from tests.scoring.paper_run import METHODS


@pytest.fixture(scope="module")
def runs() -> list[RunScores]:
    return [RunScores(scores=[score_recording(recording) for recording in make()]) for make in METHODS.values()]


@pytest.fixture(scope="module")
def tables(runs: list[RunScores]) -> dict[str, Table]:
    return {table.name: table for table in tables_of(runs, load_protocol("bathing-v3"))}


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
    for ours, papers in ((name, f"Paper: {name}") for name in ("C1 [N]", "C2 [mrad]", "C4", "C5 [N]")):
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
    tables = {t.name: t for t in tables_of([runs[0], RunScores(scores=mine)], load_protocol("bathing-v3"))}
    assert tables["rates"].rows[1][0] == "mine_&_50%"
    assert tables["rates"].rows[1][3] == "-"
    assert {row[3] for row in tables["tests"].rows} == {"-"}
    assert r"mine\_\&\_50\% &" in tables["rates"].latex()
    assert list(csv.reader(io.StringIO(tables["rates"].csv())))[4][0] == "mine_&_50%"


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
        assert sum(line.count(" & ") for line in text.splitlines()) == (len(table.rows) + 1) * (len(table.head) - 1)


def test_a_table_that_fits_a_column_takes_one(tables: dict[str, Table]) -> None:
    wide = {name: r"\begin{table*}" in table.latex() for name, table in tables.items()}
    assert {name for name, is_wide in wide.items() if not is_wide} == {"tests"}


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX")
def test_latex_compiles_every_table(tables: dict[str, Table], tmp_path: Path) -> None:
    """Within the width of its place, but for what is invisible, and within the height of a page."""
    parts = "\n".join(table.latex() for table in tables.values())
    head = "\\documentclass[twocolumn,10pt]{article}\\usepackage[T1]{fontenc}\\usepackage{booktabs,tabularx}"
    (tmp_path / "all.tex").write_text(f"{head}\\begin{{document}}\n{parts}\nx\\end{{document}}\n")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Float too large" not in done.stdout
    assert max((float(pt) for pt in re.findall(r"Overfull \\hbox \(([\d.]+)pt", done.stdout)), default=0) < 6


def test_latex_sets_numbers_and_a_method_in_mathematics(tables: dict[str, Table]) -> None:
    scores = tables["scores"].latex()
    assert "$-0.361$ (n=20) & $-0.361$ &" in scores
    assert r"$\pi_{0.5}$ &" in scores
    assert "$4.74 \\times 10^{-14}$" in tables["tests"].latex()
    text = Table(name="x", caption="a-1 T1-T7, 45-60 and -2.5 N", head=("0.35e",), rows=()).latex()
    assert r"a-1 T1-T7, 45-60 and $-2.5$ N" in text
    assert "0.35e" in text


def test_the_csv_of_rates_has_one_number_in_each_column(tables: dict[str, Table]) -> None:
    rows = list(csv.DictReader(io.StringIO(tables["rates"].csv())))
    assert [row["rate"] for row in rows[:3]] == ["success", "region_correct", "safety_gated"]
    gated = rows[2]
    assert float(gated["percent"]) == pytest.approx(100 * int(gated["passed"]) / int(gated["trials"]))
    assert [float(gated[f"paper_percent{end}"]) for end in ("", "_low", "_high")] == [56.4, 48.2, 64.4]
    medians = list(csv.DictReader(io.StringIO(tables["scores"].csv())))
    assert [float(row["median"]) for row in medians] == pytest.approx(
        [float(row["paper_median"]) for row in medians], rel=6e-3
    )
    anatomy = list(csv.DictReader(io.StringIO(tables["anatomy"].csv())))
    assert [row["target"] for row in anatomy] == [row["paper_target"] for row in anatomy]


def wide_runs(seeds: int) -> list[RunScores]:
    """T1 alone on a level with persons that the seed draws."""
    level = load_protocol("bathing-wide-v2", level="L2")
    of_level = {"protocol_id": level.name, "protocol_sha256": level.sha256}
    return [
        RunScores(scores=[make_score("T1", seed, policy=policy).model_copy(update=of_level) for seed in range(seeds)])
        for policy in ("state-machine", "voxposer")
    ]


def test_the_protocol_table_counts_what_ran() -> None:
    runs, level = wide_runs(3), load_protocol("bathing-wide-v2", level="L2")
    tables = {table.name: table for table in tables_of(runs, level)}
    ours = {row[0]: row[1] for row in tables["protocol"].rows}
    planned = len(level.randomization.seeds)
    assert ours["Initialisations"] == f"3 of {planned} planned a task"
    assert ours["Tasks"] == "1 of 7 planned"
    assert ours["Runs a method"] == f"3 of {7 * planned} planned"
    assert ours["Person"] == "9 bodies, drawn by the seed"
    assert "exam: touch least 1 N, most 6 N" in ours["Success gates"]
    names = {row[0]: row[1] for row in tables["tasks"].rows}
    assert names["T1"] == "Touch forearm"
    assert [task for task, name in names.items() if name.endswith("(not run)")] == ["T2", "T3", "T4", "T5", "T6", "T7"]
    shorter = {row[0]: row[1] for row in tables_of([runs[0], wide_runs(2)[1]], level)[3].rows}
    assert (shorter["Runs a method"], shorter["Seeds"]) == (
        f"2 to 3 of {7 * planned} planned",
        "not the same for all methods",
    )


def test_the_protocol_table_has_every_item_of_the_paper(tables: dict[str, Table]) -> None:
    cells = {row[0]: row for row in tables["protocol"].rows}
    assert {"Assets", "Success gates", "Logger schema", "Replay", *read_paper().protocol} <= set(cells)
    for item in ("Comfort-arm angle", "Tasks", "Runs a method", "Safety gate", "Initialisations"):
        assert cells[item][1] == cells[item][2]


@pytest.mark.parametrize("known", [True, False])
def test_values_of_the_paper_beside_runs_of_other_rules_have_a_note(known: bool, tables: dict[str, Table]) -> None:
    level = load_protocol("bathing-wide-v2", level="L2") if known else None
    found = {table.name: table for table in tables_of(wide_runs(6), level)}
    for name in ("rates", "scores", "tests", "anatomy"):
        assert "These runs are of bathing-wide-v2 L2" in found[name].markdown()
        assert "These runs are of" not in tables[name].markdown()
    if known:
        assert "in gates, the person, what the seed draws" in found["rates"].notes[-1]


def test_fewer_trials_than_the_papers_have_a_note(tables: dict[str, Table]) -> None:
    few = RunScores(scores=[make_score(task, seed, policy="state-machine") for task in ("T1", "T2") for seed in (0, 1)])
    found = {table.name: table for table in tables_of([few], load_protocol("bathing-v3"))}
    for name in ("rates", "scores", "tests", "anatomy"):
        if name in found:
            assert "A run here has 4 trials of 2 of the 7 tasks" in found[name].markdown()
        assert "A run here has" not in tables[name].markdown()
    assert "rates" in found


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
        (row,) = next(
            t for t in tables_of([RunScores(scores=scores)], load_protocol("bathing-v3")) if t.name == "rates"
        ).rows
        assert row[1] == f"{2 * seeds}/{2 * seeds}"
        assert ("(" in row[2]) is enough


# The paper's printed values agree with one another; a slip in typing them would not.

PAPER = read_paper()
GATED = {"state-machine": 79, "voxposer": 39, "pi05": 0}
"""Counts from the paper's text; successes are the sums over the regions."""
CORRECT = {"state-machine": 102, "voxposer": 39, "pi05": 0}


@pytest.mark.parametrize("name", PAPER.methods)
def test_rates_and_intervals_are_those_of_the_counts(name: str) -> None:
    method, n = PAPER.methods[name], PAPER.runs_per_method
    counts = {
        "success": sum(c["success"] for c in method.anatomy.values()),
        "region_correct": CORRECT[name],
        "safety_gated": GATED[name],
    }
    for rate, k in counts.items():
        found = wilson_interval(k, n)
        assert method.rates[rate] == pytest.approx((k / n, found.low, found.high), abs=5.1e-4), rate


@pytest.mark.parametrize("name", PAPER.methods)
def test_failures_and_regions_add_up(name: str) -> None:
    method = PAPER.methods[name]
    assert sum(c["n"] for c in method.anatomy.values()) == PAPER.runs_per_method
    assert method.failed == PAPER.runs_per_method - CORRECT[name]
    left = [c["n"] - c["target"] - c["off_target"] - c["none"] for c in method.anatomy.values()]
    assert left == {"state-machine": [3, 3, 1], "voxposer": [1, 3, 1], "pi05": [1, 2, 1]}[name], "process failures"
    if method.dominant is not None:
        assert method.dominant[1] <= method.failed


def test_the_contrasts_are_the_four_of_the_table() -> None:
    tests = {name: test for name, (test, _) in PAPER.pvalues.items()}
    rank = "Mann-Whitney U"
    assert tests == {"region_correct": "Fisher exact", "safety_gated": "Fisher exact", "C1": rank, "C5": rank}


def test_fisher_of_the_counts_is_the_printed_p() -> None:
    from carecontact.stats import fisher_exact

    for outcome, counts in (("region_correct", CORRECT), ("safety_gated", GATED)):
        found = fisher_exact(counts["state-machine"], 140, counts["voxposer"], 140).pvalue
        assert found == pytest.approx(PAPER.pvalues[outcome][1], rel=0.01)


# The panels of the figure of outcomes hold what their titles say.

GOLDEN = Path(__file__).parents[1] / "golden"


def panels(methods: list[Method], paths: list[list[Recording]]) -> dict[str, Axes]:
    """Title without its letter -> the panel."""
    figure = Figure()
    paper_figures.draw_outcomes(figure, methods, paths)
    figure.draw_without_rendering()
    return {axes.get_title(loc="center").partition(") ")[2]: axes for part in figure.subfigs for axes in part.axes}


def method(title: str, modes: dict[str, int]) -> Method:
    failed = [FAILED | {"failure_mode": mode} for mode, count in modes.items() for _ in range(count)]
    scores = [make_score("T1", seed, policy=title, **fields) for seed, fields in enumerate(failed)]
    return Method(policy=title, title=title, scores=scores, published=None)


def test_every_count_of_a_failure_has_its_number_and_no_empty_class_a_bar() -> None:
    two = [method("a", {"time_limit": 90, "process_failure": 1}), method("b", {"time_limit": 3})]
    panel = panels(two, [[], []])["Why trials failed"]
    bars = sorted(bar.get_width() for bar in panel.patches)  # pyright: ignore[reportAttributeAccessIssue]
    assert bars == [1, 3, 90]
    assert sorted(text.get_text() for text in panel.texts) == ["1", "3", "90"]
    legend = panel.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["time limit", "process failure"]


def test_paths_are_drawn_region_by_region_with_an_outline_and_names() -> None:
    run = score_run(GOLDEN)
    recordings = [read_recording(GOLDEN / f"{task}-s000.h5") for task in ("T1", "T2", "T6")]
    shown = panels(methods_of([run], read_paper()), [recordings])
    assert [title for title in shown if "tool path" in title] == ["Forearm: tool path [mm]", "Abdomen: tool path [mm]"]
    forearm = shown["Forearm: tool path [mm]"]
    lines = {str(line.get_label()): line for line in forearm.lines}
    assert {"T1", "T2", "region"} <= set(lines)
    legend = forearm.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y1 < forearm.get_window_extent().y0, "the legend covers no path"
    size_m = recordings[0]["scorer/region_size_m"][recordings[0].header.regions.index("forearm")]
    x, y = lines["region"].get_data()
    assert (max(x) - min(x), max(y) - min(y)) == pytest.approx((1000 * size_m[0], 2000 * size_m[1]))  # type: ignore[arg-type]


def test_a_force_has_its_spread_within_the_trial() -> None:
    run = score_run(GOLDEN)
    shown = panels(methods_of([run], read_paper()), [[]])
    push = shown["Push: force,\nmean and SD [N]"]
    (score,) = [s for s in run.scores if s.action == "push"]
    (bar,) = push.collections[0].get_segments()  # pyright: ignore[reportAttributeAccessIssue]
    assert score.c5_force_sd_n is not None
    assert bar[1, 1] - bar[0, 1] == pytest.approx(2 * score.c5_force_sd_n)


def test_all_methods_are_drawn_in_the_trial_in_which_most_of_them_succeed() -> None:
    first = method("a", {"time_limit": 3})
    second = replace(first, title="b", scores=[first.scores[0], make_score("T1", 1), make_score("T1", 9)])
    assert one_of_each_task([first, second]) == [["T1-s001"], ["T1-s001"]]
    assert one_of_each_task([replace(first, scores=[]), second]) == [[], ["T1-s001"]]


def test_traces_have_a_line_of_its_colour_for_each_method_and_one_scale_a_column() -> None:
    run = score_run(GOLDEN)
    recordings = [read_recording(GOLDEN / f"{task}-s000.h5") for task in ("T1", "T2")]
    figure = Figure()
    paper_figures.draw_traces(figure, methods_of([run, run], read_paper()), [recordings, recordings[:1]])
    rows = [figure.axes[4 * row + 1 : 4 * row + 4] for row in range(2)]
    assert [[line.get_color() for line in panel.lines] for row in rows for panel in row] == (
        [list(paper_figures.COLOURS[:2])] * 3 + [[paper_figures.COLOURS[0]]] * 3
    )
    assert [panel.get_ylim() for panel in rows[0]] == [panel.get_ylim() for panel in rows[1]]


def test_the_papers_median_stands_beside_the_trials_of_its_method_alone(runs: list[RunScores]) -> None:
    ours, paper = methods_of(runs[:1], read_paper())[0], read_paper()
    panel = panels([ours, replace(ours, title="another", published=None)], [[], []])["Motion activity, C4"]
    marks = [line.get_xydata() for line in panel.lines if line.get_marker() == "D"]
    assert [point.tolist() for point in marks] == [[[0, paper.methods[ours.policy].medians["C4"]]]]  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    legend = panel.figure.legends[0]
    assert [text.get_text() for text in legend.get_texts()] == [ours.title, "another", "median", "median in the paper"]
