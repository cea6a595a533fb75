"""Success over level, one factor at a time and the order under other gates, from trials whose outcome is known."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from carecontact.policies.registry import Role
from carecontact.reports.sweep import page as sweep_page
from carecontact.reports.sweep.curve import curve_svg
from carecontact.reports.sweep.factors import factors
from carecontact.reports.sweep.gate_texts import gate_rows, gate_titles
from carecontact.reports.sweep.ladder import Ladder, ladder
from carecontact.reports.sweep.level_texts import factor_rows, level_rows
from carecontact.reports.sweep.page import write_sweep
from carecontact.reports.sweep.provenance import provenance
from carecontact.reports.sweep.table import CellScores, sweep_table
from carecontact.reports.sweep.texts import as_markdown, sentences
from carecontact.runs.sweep.factors import ALL, AXIS, NONE, alone, without
from carecontact.scoring import TrialScore
from tests.reports.synthetic_run import FAILED, make_score

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
        NONE: "++++++++", alone("light"): "--------", alone("place"): "++++++++", ALL: "--------",
        without("light"): "++++++++", without("place"): "--------",
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
    for told in (page, text):
        assert "–" not in told


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
