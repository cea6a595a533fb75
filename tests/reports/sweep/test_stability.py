from __future__ import annotations

from math import comb

import pytest

from carecontact.reports.sweep.stability import Group, Stability, stability
from carecontact.reports.sweep.table import CellScores, sweep_table
from carecontact.reports.sweep.texts import as_csv, as_markdown, sentences
from carecontact.scoring import TrialScore
from tests.reports.synthetic_run import FAILED, make_score


def trials(name: str, passed: str) -> list[TrialScore]:
    """One trial for each letter, seeds from 0: + passes, - fails, anything else did not run."""
    return [
        make_score("T1", seed, policy=name, **({} if mark == "+" else FAILED))
        for seed, mark in enumerate(passed)
        if mark in "+-"
    ]


def found(*groups: tuple[dict[str, str], dict[str, str]]) -> Stability:
    made = [
        Group(values=values, scores={name: trials(name, marks) for name, marks in passed.items()})
        for values, passed in groups
    ]
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
    assert stability([Group(values={}, scores={"a": trials("a", "+")})], ["a", "b"], outcome="safety_gated") is None


def test_equal_policies_have_no_order_to_lose() -> None:
    result = found(({"body": "x"}, {"a": "+-", "b": "+-"}), ({"body": "y"}, {"a": "++", "b": "++"}))
    assert (result.same, result.taus, result.unordered) == (2, (), 2)
    assert result.orders[0].equal == 2


def test_the_table_has_a_row_for_each_cell_and_says_what_lacks() -> None:
    cells = [
        CellScores(label=name, values={"body": body}, folder="cells/x", planned=2, scores=trials(name, marks))
        for body, name, marks in (("x", "a", "++"), ("x", "b", "+-"), ("y", "a", "-+"), ("y", "b|c", ""))
    ]  # fmt: skip
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
