"""Success over level, one factor at a time and the order under other gates, from trials whose outcome is known."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import comb
from pathlib import Path
from typing import Any

import pytest

from carecontact.policies.registry import Role
from carecontact.report import sweep_page
from carecontact.report.sweep_levels import Ladder, factors, ladder
from carecontact.report.sweep_page import curve_svg, write_sweep
from carecontact.report.sweep_table import Bands, CellScores, Stability, bands, stability, sweep_table
from carecontact.report.sweep_texts import (
    as_csv,
    as_markdown,
    factor_rows,
    flip_rows,
    gate_rows,
    gate_titles,
    level_rows,
    level_tables,
    provenance,
    sentences,
    spread_rows,
)
from carecontact.runs.sweep import ALL, AXIS, NONE, only_factor, without_factor
from carecontact.scoring import TrialScore
from carecontact.stats import person_rate
from tests.report.synthetic import FAILED, make_score

ROLES: dict[str, Role] = {"blind": "blind", "still": "blind", "truth": "privileged"}


def cell(name: str, value: str, passed: Mapping[str, str], *, axis: str = "protocol", **fields: Any) -> CellScores:
    """``passed``: task -> a letter for each seed from 0, + passes, - fails, anything else did not run."""
    scores = [
        make_score(task, seed, policy=name, **(fields if mark == "+" else FAILED | fields))
        for task, marks in passed.items()
        for seed, mark in enumerate(marks)
        if mark in "+-"
    ]
    return CellScores(
        label=name,
        role=ROLES.get(name, "method"),
        values={axis: value},
        folder=name,
        planned=len(scores),
        scores=scores,
    )


def levels(**rates: tuple[str, str]) -> list[CellScores]:
    """Policy -> the outcomes of task T1 on L0 and on L1."""
    return [
        cell(name, f"wide {level}", {"T1": marks[k]})
        for k, level in enumerate(("L0", "L1"))
        for name, marks in rates.items()
    ]


def climbed(cells: list[CellScores]) -> Ladder:
    found = ladder(cells, "safety_gated")
    assert found is not None
    return found


def test_the_best_blind_baseline_of_each_level_is_beside_every_rate() -> None:
    found = climbed(levels(a=("++++++", "++++--"), blind=("+++---", "------"), still=("------", "+-----")))
    assert [rung.best_blind for rung in found.rungs] == ["blind", "still"]
    above = [rung.climbs[0].above_blind for rung in found.rungs]
    assert [one.estimate for one in above if one] == [pytest.approx(0.5), pytest.approx(0.5)]
    assert found.rungs[0].climbs[1].above_blind is None
    assert [row[4] for row in level_rows(found)][1] == "best blind"
    assert [(c.rate.k, c.rate.n) for rung in found.rungs for c in rung.climbs] == [
        (6, 6), (3, 6), (0, 6), (4, 6), (0, 6), (1, 6)
    ]  # fmt: skip


def test_methods_are_compared_level_by_level_and_baselines_are_not() -> None:
    """Eight persons, on all of whom one method alone passes: 2 of 2^8 signs."""
    found = climbed(levels(a=("++++++++", "++++++++"), b=("++++++++", "--------"), blind=("--------", "--------")))
    assert [[(c.a, c.b) for c in rung.contrasts] for rung in found.rungs] == [[("a", "b")], [("a", "b")]]
    (same,), (apart,) = (rung.contrasts for rung in found.rungs)
    assert (same.difference.estimate, same.p_holm) == (0.0, 1.0)
    assert apart.difference.test.pvalue == pytest.approx(2 / 2**8)
    assert apart.p_holm == pytest.approx(2 * 2 / 2**8)


def test_methods_alone_are_ranked_and_a_plan_of_one_ranks_all() -> None:
    two = sweep_table("x", levels(a=("++", "++"), b=("+-", "--"), truth=("++", "++")), rank_by="safety_gated")
    assert two.stability is not None
    assert list(two.stability.passed) == ["a", "b"]
    assert "truth" not in sentences(two)[1]
    one = sweep_table("x", levels(a=("++", "++"), blind=("--", "--")), rank_by="safety_gated")
    assert one.stability is not None
    assert list(one.stability.passed) == ["a", "blind"]


def test_the_table_says_tasks_worst_tenth_and_harder_band() -> None:
    passed = {"T1": "++-", "T2": "++-"}
    cells = [
        cell("a", "wide L0", passed, additional={"harder_band@2": 1.0}),
        cell("a", "wide L1", passed, additional={"harder_band@2": 0.0}),
    ]
    found = climbed(cells)
    easy, hard = (rung.climbs[0] for rung in found.rungs)
    assert easy.by_task == {"T1": (2, 3), "T2": (2, 3)}
    assert (easy.harder, hard.harder) == ((6, 6), (0, 6))
    assert easy.worst.estimate == 0.0
    assert easy.worst.by_chance is not None
    assert easy.worst.by_chance > 0.0
    page = as_markdown(sweep_table("x", cells, rank_by="safety_gated"))
    assert "| wide L0 | a | 4/6 | 67 % " in page
    assert "| wide L0 | a | 2/3 | 2/3 |" in page


def test_the_figure_has_a_point_and_an_interval_for_each_rate() -> None:
    svg = curve_svg(climbed(levels(a=("++++++", "+++---"), blind=("+-----", "------"), truth=("++++++", "++++++"))))
    assert svg.count('class="dot') == svg.count('class="whisker') == 6
    assert svg.count("<polyline") == 3
    assert ">L0<" in svg
    assert "wide L1: a 3 of 6, blind 0 of 6, truth 6 of 6" in svg


@pytest.mark.parametrize("persons", [5, 6])
def test_fewer_than_six_persons_have_no_interval(persons: int) -> None:
    passed = "+" * (persons - 2) + "--"
    found = climbed(levels(a=(passed, passed), blind=("-" * persons, "-" * persons)))
    enough = persons >= 6
    assert ('class="whisker' in curve_svg(found)) is enough
    for row in level_rows(found):
        assert ("[" in "".join(row)) is enough


def test_policies_of_one_colour_differ_by_their_marks() -> None:
    """All blind baselines are grey."""
    svg = curve_svg(climbed(levels(a=("++", "++"), blind=("+-", "--"), still=("--", "--"), truth=("++", "++"))))
    marks = re.findall(r'class="dot [^"]+" d="M[-\d.]+ [-\d.]+(m[^"]+)"', svg)
    assert len(marks) == 8
    assert marks[0::2] == marks[1::2], "a policy keeps its mark on every level"
    assert len(set(marks)) == 4


def test_one_protocol_is_no_ladder_and_an_empty_sweep_neither() -> None:
    assert ladder([cell("a", "L0", {"T1": "+"})], "safety_gated") is None
    assert ladder([cell("a", "L0", {}), cell("a", "L1", {})], "safety_gated") is None


def test_the_factor_that_breaks_a_policy_costs_alone_and_gives_back_without() -> None:
    """Light breaks it and place does not, eight persons."""
    outcomes = {
        NONE: "++++++++", only_factor("light"): "--------", only_factor("place"): "++++++++", ALL: "--------",
        without_factor("light"): "++++++++", without_factor("place"): "--------",
    }  # fmt: skip
    found = factors([cell("a", value, {"T1": marks}, axis=AXIS) for value, marks in outcomes.items()], "safety_gated")
    assert found is not None
    light, place = found.effects
    assert (light.factor, light.costs.estimate, light.gives_back.estimate) == ("light", -1.0, 1.0)
    assert (place.factor, place.costs.estimate, place.gives_back.estimate) == ("place", 0.0, 0.0)
    assert light.costs_p_holm == light.gives_back_p_holm == pytest.approx(4 * 2 / 2**8)
    assert place.costs_p_holm == 1.0
    assert [row[1] for row in factor_rows(found)] == ["none", "light", "place", "all"]
    assert factors([cell("a", "L0", {"T1": "+"})], "safety_gated") is None


def test_an_order_that_another_gate_turns_is_named_with_its_place() -> None:
    """On L1, b would be ahead of a if a lighter push were enough."""

    def swept(name: str, value: str, marks: str, light: str) -> CellScores:
        made = cell(name, value, {"T2": marks})
        scores: list[TrialScore] = [
            score.model_copy(
                update={"gate_sweep": {"push_force_n": {"1": 3 * (light[k] == "+"), "3": 3 * (marks[k] == "+")}}}
            )
            for k, score in enumerate(made.scores)
        ]
        return CellScores(
            label=name, role="method", values=made.values, folder=name, planned=len(scores), scores=scores
        )

    cells = [
        swept("a", "L0", "++++", "++++"), swept("b", "L0", "++--", "++--"),
        swept("a", "L1", "+++-", "+++-"), swept("b", "L1", "++--", "++++"),
    ]  # fmt: skip
    table = sweep_table("x", cells, rank_by="safety_gated")
    pushes = {order.place: (order.least, order.setting) for order in table.gate_orders if order.gate == "push_force_n"}
    assert pushes["L1"] == (-1.0, "push_force_n 1")
    assert pushes["L0"][0] == 1.0
    titles = gate_titles([score for cell in cells for score in cell.scores])
    first, *others = gate_rows(table.gate_orders, titles)
    assert first == ["Push: force (push_force_n)", "1.00", "1.00", "-1.00 (at 1)"]
    assert [row[0][:20] for row in others] == ["All others: Region-c"]
    assert len(gate_rows([one for one in table.gate_orders if one.gate != "push_force_n"], titles)) == 1


def test_gates_of_actions_that_did_not_run_are_left_out() -> None:
    gates = {"gate_sweep": {"push_force_n": {"1": 3}, "floor_n": {"1": 3}}}
    cells = [
        replace(one, scores=[score.model_copy(update=gates) for score in one.scores])
        for one in levels(a=("+", "-"), b=("+", "+"))
    ]
    table = sweep_table("x", cells, rank_by="safety_gated")
    assert {order.gate for order in table.gate_orders} >= {"push_force_n", "floor_n"}
    page = as_markdown(table)
    assert "Contact floor" in page
    assert "push_force_n" not in page
    assert "Push: force" not in page


def test_a_blind_baseline_is_called_so_and_changes_no_places() -> None:
    """Also without levels, where no ladder says so."""
    cells = [cell(name, "L0", {"T1": "++-", "T2": "+-+"}) for name in ("a", "b", "blind")]
    cells[1] = cell("b", "L0", {"T1": "-++", "T2": "--+"})
    table = sweep_table("x", cells, rank_by="safety_gated")
    assert table.ladder is None
    assert "Not ranked, because they are no methods: blind (blind)." in sentences(table)
    page = as_markdown(table)
    assert "| a - b | T2 |" in page
    assert "a - blind" not in page
    assert "| blind (blind) | L0 |" in page


def test_the_page_says_what_decided_its_numbers_and_where_each_run_is() -> None:
    cells = levels(a=("+", "-"), b=("+", "+"))
    table = sweep_table("plan", cells, rank_by="safety_gated")
    rows = dict(provenance(table))
    first = cells[0].scores[0]
    assert first.protocol_sha256[:12] in rows["protocols, with their hashes"]
    assert (rows["plan"], rows["tasks"], rows["seeds"]) == ("plan", "T1", "0")
    assert rows["recordings"].startswith("4 trials; ")
    assert "gates paper" in rows["definitions of the scores"]
    page, text = sweep_page._page(table), as_markdown(table)  # pyright: ignore[reportPrivateUsage]
    for what, value in rows.items():
        assert f"| {what} | {value} |" in text
        assert value in page
    assert '<a href="a/">a</a>' in page
    assert "| `a` |" in text
    for wording in (page, text):
        assert "–" not in wording


def test_levels_of_one_protocol_are_the_ladder() -> None:
    cells = [
        CellScores(label="a", values={"protocol": "wide", "level": level}, folder="a", planned=1,
                   scores=[make_score("T1", 0, policy="a")])
        for level in ("L0", "L1")
    ]  # fmt: skip
    assert [rung.value for rung in climbed(cells).rungs] == ["wide L0", "wide L1"]


def test_a_policy_without_trials_is_in_no_legend(tmp_path: Path) -> None:
    cells = levels(a=("++++++", "++++--"), b=("......", "......"))
    page = write_sweep(tmp_path, sweep_table("x", cells, rank_by="safety_gated"))[0].read_text()
    legend = page.partition('<ul class="legend">')[2].partition("</ul>")[0]
    assert re.findall(r"</svg>([^<]*)", legend) == ["a"]
    assert "b 0 of 0" not in page


# The spread over draws, from trials whose scores are known.


def band_cell(name: str, body: str, peaks: Sequence[float], *, fails: Sequence[int] = ()) -> CellScores:
    """Task T1 with a peak force [N] for each seed from 0."""
    scores = [
        make_score("T1", seed, policy=name, c1_peak_force_n=peak, **(FAILED if seed in fails else {}))
        for seed, peak in enumerate(peaks)
    ]
    return CellScores(label=name, values={"body": body}, folder=f"{name}_{body}", planned=len(scores), scores=scores)


def drawn(cells: Sequence[CellScores]) -> Bands:
    found = bands(cells, "safety_gated", ranked=list(dict.fromkeys(one.label for one in cells)))
    assert found is not None
    return found


def heads_of(title: str, cells: Sequence[CellScores]) -> Sequence[str]:
    tables = level_tables(sweep_table("x", cells, rank_by="safety_gated"))
    return next(heads for name, heads, _ in tables if name == title)


def column(heads: Sequence[str], rows: Sequence[Sequence[str]], name: str) -> Mapping[str, str]:
    return {row[0]: row[list(heads).index(name)] for row in rows}


def test_a_band_is_over_all_draws_of_a_policy() -> None:
    cells = [band_cell("a", "thin", range(1, 12)), band_cell("a", "heavy", range(12, 22), fails=[0])]
    found = drawn(cells)
    (one,) = found.spreads
    assert (one.passed, one.n) == (20, 21)
    band = one.bands["C1@1"]
    assert band is not None
    assert (band.n, band.low, band.median, band.high) == (21, 2.0, 11.0, 20.0)
    assert column(heads_of("Spread over the draws", cells), spread_rows(found, {"a": "a"}), "C1 [N]")["a"].startswith(
        "11.00 [2.00 to 20.00]"
    )


def test_flips_are_the_draws_that_go_against_the_order_over_all() -> None:
    """b presses harder than a in three of four draws and less in one; it fails in one in which a passes."""
    cells = [
        band_cell("a", "thin", [2, 2]), band_cell("a", "heavy", [2, 2], fails=[1]),
        band_cell("b", "thin", [3, 1]), band_cell("b", "heavy", [3, 3], fails=[0, 1]),
    ]  # fmt: skip
    (pair,) = drawn(cells).flips
    assert (pair.a, pair.b, pair.by["C1@1"], pair.by["passed"]) == ("a", "b", (1, 4), (0, 4))
    assert (
        column(heads_of("Draws in which two policies change places", cells), flip_rows(drawn(cells)), "C1")[
            "a - b"
        ].replace("\xa0", " ")
        == "1/4 (25 %)"
    )


def test_equal_policies_have_no_order_to_flip() -> None:
    assert drawn([band_cell("a", "thin", [2, 3]), band_cell("b", "thin", [3, 2])]).flips == ()


def test_one_draw_has_no_band_and_levels_are_no_draws() -> None:
    assert bands([band_cell("a", "thin", [2])], "safety_gated", ranked=["a"]) is None
    assert sweep_table("x", levels(a=("++", "+-"), b=("++", "--")), rank_by="safety_gated").bands is None
    wording = as_markdown(sweep_table("x", [band_cell("a", "thin", [2, 3])], rank_by="safety_gated"))
    assert "## Spread over the draws" in wording


def trials(name: str, passed: str) -> list[TrialScore]:
    """One trial for each letter, seeds from 0: + passes, - fails, anything else did not run."""
    return [
        make_score("T1", seed, policy=name, **({} if mark == "+" else FAILED))
        for seed, mark in enumerate(passed)
        if mark in "+-"
    ]


def found(*groups: tuple[dict[str, str], dict[str, str]]) -> Stability:
    made = {
        tuple(values.items()): {name: trials(name, marks) for name, marks in passed.items()}
        for values, passed in groups
    }
    result = stability(made, list(groups[0][1]), outcome="safety_gated")
    assert result is not None
    return result


def test_an_order_that_turns_along_an_axis_is_counted() -> None:
    """b is better on one body, by less than a is on the two others."""
    result = found(
        ({"body": "x"}, {"a": "+++-", "b": "+---"}),
        ({"body": "y"}, {"a": "+++-", "b": "+---"}),
        ({"body": "z"}, {"a": "++--", "b": "+++-"}),
    )
    assert (result.n, result.groups, result.seeds) == (12, 3, 4)
    assert result.passed == {"a": 8, "b": 5}
    assert (result.same, result.taus, result.unordered) == (2, (1.0, 1.0, -1.0), 0)
    (order,) = result.orders
    assert (order.a, order.b, order.difference) == ("a", "b", pytest.approx(3 / 12))
    assert (order.higher, order.equal, order.lower) == (2, 0, 1)
    assert [(row.value, row.passed, row.tau) for row in result.marginals] == [
        ("x", {"a": 3, "b": 1}, 1.0), ("y", {"a": 3, "b": 1}, 1.0), ("z", {"a": 2, "b": 3}, -1.0)
    ]  # fmt: skip


def test_the_seeds_are_drawn_with_all_their_trials() -> None:
    """a is ahead by 3 on one seed of six and behind by 1 on another: behind only where the other is drawn more than
    three times as often as the first."""
    result = found(
        ({"body": "x"}, {"a": "+-----", "b": "-+----"}),
        ({"body": "y"}, {"a": "+-----", "b": "------"}),
        ({"body": "z"}, {"a": "+-----", "b": "------"}),
    )
    (order,) = result.orders
    chance = {(i, j): comb(6, i) * comb(6 - i, j) * 4 ** (6 - i - j) / 6**6 for i in range(7) for j in range(7 - i)}
    assert order.resampled_higher == pytest.approx(sum(p for (i, j), p in chance.items() if 3 * i > j), abs=0.02)
    assert order.resampled_lower == pytest.approx(sum(p for (i, j), p in chance.items() if 3 * i < j), abs=0.02)
    assert order.resampled_equal == pytest.approx(sum(p for (i, j), p in chance.items() if 3 * i == j), abs=0.02)
    assert found(({}, {"a": "+----", "b": "-----"})).orders[0].resampled_higher is None, "five seeds are too few"


def test_only_trials_that_every_policy_ran_count() -> None:
    result = found(({"body": "x"}, {"a": "++ +", "b": "+-- "}), ({"body": "y"}, {"a": "  ++", "b": "+-  "}))
    assert (result.n, result.groups, result.passed) == (2, 1, {"a": 2, "b": 1})
    assert stability({(): {"a": trials("a", "+")}}, ["a", "b"], outcome="safety_gated") is None


def test_equal_policies_have_no_order_to_lose() -> None:
    result = found(({"body": "x"}, {"a": "+-", "b": "+-"}), ({"body": "y"}, {"a": "++", "b": "++"}))
    assert (result.same, result.taus, result.unordered) == (2, (), 2)
    assert result.orders[0].equal == 2


def test_intervals_of_the_table_are_over_persons() -> None:
    scores = [
        make_score(task, seed, protocol_id="bathing-wide-v2 L2", safety_gated=seed % 2 == 0)
        for seed in range(6)
        for task in ("T1", "T3")
    ]
    cell = CellScores(label="a", values={"body": "x"}, folder="cells/a", planned=12, scores=scores)
    head, row = (line.split(",") for line in as_csv(sweep_table("bodies", [cell], rank_by="safety_gated")).splitlines())
    at = head.index("safety_gated")
    over = person_rate([s.safety_gated for s in scores], persons=[s.seed for s in scores])
    assert [float(value) for value in row[at + 2 : at + 4]] == [100 * over.low, 100 * over.high]


def test_the_table_has_a_row_for_each_cell_and_says_what_lacks() -> None:
    cells = [
        CellScores(label=name, values={"body": body}, folder="cells/x", planned=2, scores=trials(name, marks))
        for body, name, marks in (("x", "a", "++"), ("x", "b", "+-"), ("y", "a", "-+"), ("y", "b|c", ""))
    ]
    table = sweep_table("bodies", cells, rank_by="safety_gated")
    assert (table.axes, table.policies, table.unfinished) == (("body",), ("a", "b", "b|c"), 1)
    assert sentences(table)[1].startswith(
        "Incomplete: 1 cell lacks the verdict on planned trials; each count there goes"
    )
    assert table.stability is not None
    assert list(table.stability.passed) == ["a", "b"], "who is incomplete is not ranked"
    assert "4 cells of 3 policies, 6 of 8 trials." in sentences(table)
    lines = [line.split(",") for line in as_csv(table).splitlines()]
    assert lines[0][:7] == ["policy", "body", "folder", "planned", "trials", "crashed", "harness_errors"]
    gated = lines[0].index("safety_gated")
    assert {line[gated + 2] for line in lines[1:]} == {""}, "two seeds are too few for an interval"
    assert "There are no intervals: fewer than 6 seeds." in sentences(table)
    assert [(line[0], line[1], line[gated]) for line in lines[1:]] == [
        ("a", "x", "2"), ("b", "x", "1"), ("a", "y", "1"), ("b|c", "y", "")
    ]  # fmt: skip
    assert {len(line) for line in lines} == {len(lines[0])}
    assert "| b\\|c | y | 0/2 | 0–2/2 |" in as_markdown(table)
