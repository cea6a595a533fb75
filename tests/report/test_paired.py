"""Statistics over seeds where a protocol draws persons: clusters, equal figures everywhere, and the order of trials."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.report.baselines import beside_baselines
from carecontact.report.comparison import Comparison, compare_runs
from carecontact.report.overview import overview
from carecontact.report.paired import RateLine, ScoreLine, difference_of
from carecontact.report.sweep_levels import ladder
from carecontact.report.sweep_table import CellScores
from carecontact.runs import RunScores
from carecontact.runs.pooling import over_of, rate_of
from carecontact.scoring import TrialScore
from carecontact.stats import McNemar, SignFlip, sign_flip, signed_rank, wilson_interval
from tests.report.synthetic import FAILED, make_score

TASKS = tuple(f"T{i}" for i in range(1, 8))
DRAWN: dict[str, Any] = {"world": {"drawn body": "ab" * 32, "mujoco": "4.0.0"}}


def persons(passed: str, policy: str = "a", **fields: Any) -> list[TrialScore]:
    """``passed``: a letter for each seed, + passes every task and - fails every one."""
    return [
        make_score(task, seed, policy=policy, **(DRAWN | fields | ({} if mark == "+" else FAILED)))
        for seed, mark in enumerate(passed)
        for task in TASKS
    ]


def line(found: Comparison, id_: str = "safety_gated") -> RateLine:
    (of_id,) = (row for row in found.overall if isinstance(row, RateLine) and row.outcome.id == id_)
    return of_id


def compared(a: list[TrialScore], b: list[TrialScore]) -> Comparison:
    return compare_runs(RunScores(scores=a), RunScores(scores=b))


@pytest.mark.parametrize(
    ("fields", "over"),
    [
        ({}, "trials"),
        (DRAWN, "seeds"),
        ({"protocol_id": "somebodys L0"}, "seeds"),
    ],
)
def test_the_protocol_decides_by_what_it_declares(fields: dict[str, Any], over: str) -> None:
    assert over_of(make_score("T1", 0, **fields)) == over


def test_seven_tasks_of_one_person_are_no_seven_trials() -> None:
    """Of two persons one passes everything: each resample draws one of them, so that the interval is [0, 1]."""
    found = rate_of(persons("+-"), "safety_gated")
    assert (found.k, found.n, found.low, found.high) == (7, 14, 0.0, 1.0)
    of_trials = wilson_interval(7, 14)
    assert found.low < of_trials.low
    assert found.high > of_trials.high
    assert rate_of([s.model_copy(update={"world": {}}) for s in persons("+-")], "safety_gated") == of_trials


def test_alike_persons_leave_what_so_many_trials_would() -> None:
    for marks in ("+" * 9, "-" * 9):
        found, of_persons = rate_of(persons(marks), "safety_gated"), wilson_interval(9 * (marks[0] == "+"), 9)
        assert (found.n, found.low, found.high) == (63, of_persons.low, of_persons.high)


def test_a_difference_of_persons_is_tested_over_persons() -> None:
    """Five persons of nine pass with A alone: 2 / 2^5 over persons, and far less over their 35 trials."""
    line_ = line(compared(persons("+++++----"), persons("---------", "b")))
    assert isinstance(line_.test, SignFlip)
    assert line_.test.pvalue == pytest.approx(2 / 2**5)
    assert line_.over == "seeds"
    assert line_.verdict is not None
    assert line_.verdict.word == "underpowered"
    trials = compared(*([s.model_copy(update={"world": {}}) for s in run]
                        for run in (persons("+++++----"), persons("---------", "b"))))  # fmt: skip
    assert isinstance(line(trials).test, McNemar)
    assert line(trials).verdict != line_.verdict
    assert line_.difference.high - line_.difference.low > line(trials).difference.high - line(trials).difference.low


def test_what_could_have_been_detected_is_over_seeds() -> None:
    """Seven tasks of a person are worth no more than one, so that the smallest difference is that of one task alone."""
    marks = "+-" * 9, "-+" * 8 + "--"
    every = compared(persons(marks[0]), persons(marks[1], "b"))
    one = compared(*([s for s in run if s.task_id == "T1"] for run in (persons(marks[0]), persons(marks[1], "b"))))
    # Holm's level follows the number of lines: that of C2 is there with a push alone.
    assert len(every.overall) == len(one.overall) + 1
    wide, narrow = line(every).detectable, line(one).detectable
    assert wide is not None
    assert narrow is not None
    assert wide.difference is not None
    assert narrow.difference is not None
    assert narrow.difference < wide.difference < 1.05 * narrow.difference
    few = line(compared(persons("+-+"), persons("--+", "b"))).detectable
    assert few is not None
    assert few.difference is None, "21 pairs would be enough, three persons are not"
    alike = line(compared(persons("+" * 20), persons("+" * 20, "b")))
    assert alike.detectable is not None
    assert alike.detectable.difference is not None
    assert alike.detectable.difference > 0.2, "20 persons, and not 140 pairs"


def test_scores_are_tested_over_persons() -> None:
    """The same difference in all tasks of a person: the ranks of a person are one."""
    a = [s.model_copy(update={"c1_peak_force_n": 5.0 + s.seed}) for s in persons("+" * 6)]
    b = [s.model_copy(update={"policy": "b", "c1_peak_force_n": 4.0}) for s in a]
    (c1,) = (row for row in compared(a, b).overall if isinstance(row, ScoreLine) and row.outcome.id == "C1")
    assert c1.test.pvalue == pytest.approx(2 / 2**6)
    assert c1.worst_rank.pvalue == pytest.approx(2 / 2**6)


def test_the_tables_of_a_sweep_and_a_comparison_have_the_same_figures() -> None:
    a, b = (
        RunScores(scores=persons(marks, name, protocol_id="exam L3"))
        for name, marks in (("state-machine", "++-+--+-+"), ("voxposer", "-+--+----"))
    )
    found = line(compare_runs(a, b))
    cells = [
        CellScores(label=name, values={"level": level}, folder=name, planned=63, scores=scores)
        for name, level, scores in (
            ("state-machine", "L3", a.scores), ("voxposer", "L3", b.scores), ("voxposer", "L2", ()),
        )
    ]  # fmt: skip
    climbed = ladder(cells, "safety_gated")
    assert climbed is not None
    (contrast,) = climbed.rungs[0].contrasts
    climbs = {climb.policy: climb.rate for climb in climbed.rungs[0].climbs}
    for mine, of_table in ((found.a, climbs["state-machine"]), (found.b, climbs["voxposer"])):
        assert (mine.k, mine.n, mine.low, mine.high) == (of_table.k, of_table.n, of_table.low, of_table.high)
    of_table, mine = contrast.difference, found.difference
    assert (mine.estimate, mine.low, mine.high) == (of_table.estimate, of_table.low, of_table.high)
    assert found.test == of_table.test
    beside = beside_baselines(a, [b])
    assert beside.method.rates["safety_gated"] == found.a
    assert beside.baselines[0].rates["safety_gated"] == found.b
    assert beside.baselines[0].above is not None
    assert beside.baselines[0].above["safety_gated"] == mine


def test_an_overview_has_the_same_rates() -> None:
    runs = [
        RunScores(scores=persons(marks, name)) for name, marks in (("a", "++--++"), ("b", "+-----"), ("c", "------"))
    ]
    found = overview(runs)
    assert found.over == "seeds"
    assert found.rates["A"]["safety_gated"] == rate_of(runs[0].scores, "safety_gated")
    pair = next(pair for pair in found.pairs if (pair.a, pair.b) == ("A", "B"))
    assert line(compare_runs(*runs[:2])).difference == pair.lines[2].difference


def test_without_a_common_seed_the_intervals_of_persons_are_combined() -> None:
    other = [s.model_copy(update={"seed": s.seed + 50}) for s in persons("--+---", "hover")]
    (row,) = beside_baselines(RunScores(scores=persons("++--++")), [RunScores(scores=other)]).baselines
    assert row.n_pairs == 0
    assert row.above is not None
    own = rate_of(persons("++--++"), "safety_gated")
    assert own.estimate is not None
    assert row.above["safety_gated"].high - row.above["safety_gated"].low > own.high - own.low


@settings(deadline=None, max_examples=15)
@given(
    cells=st.lists(st.tuples(st.integers(0, 5), st.booleans(), st.booleans()), min_size=1, max_size=30),
    shuffle=st.randoms(use_true_random=False),
)
def test_the_order_of_trials_is_nothing(cells: list[tuple[int, bool, bool]], shuffle: random.Random) -> None:
    def side(k: int) -> list[TrialScore]:
        return [
            make_score(f"T{1 + i % 7}", 6 * (i // 7) + seed, policy="ab"[k], **(DRAWN | ({} if passed[k] else FAILED)))
            for i, (seed, *passed) in enumerate(cells)
        ]

    a, b = side(0), side(1)
    pairs = list(zip(a, b, strict=True))
    shuffle.shuffle(pairs)
    again = [x for x, _ in pairs], [y for _, y in pairs]
    assert rate_of(again[0], "safety_gated") == rate_of(a, "safety_gated")
    assert difference_of(*again, "safety_gated") == difference_of(a, b, "safety_gated")
    found, _ = difference_of(a, b, "safety_gated")
    assert found.estimate is not None
    assert -1 <= found.low <= found.estimate <= found.high <= 1
    mirror, test = difference_of(b, a, "safety_gated")
    assert test.pvalue == difference_of(a, b, "safety_gated")[1].pvalue
    assert mirror.estimate == pytest.approx(-found.estimate)


def test_signed_ranks_of_clusters_are_sign_flips_of_their_sums() -> None:
    first, second = [3.0, 1.0, 5.0, 2.0, None], [1.0, 2.0, 1.0, 2.0, 1.0]
    # Differences 2, -1, 4, 0: ranks 2, -1, 3; clusters 0 and 1 have 2 - 1 and 3.
    found = signed_rank(first, second, clusters=[0, 0, 1, 1, 2])
    assert found.pvalue == sign_flip([1, 3]).pvalue == 0.5
    alone = signed_rank(first, second, clusters=[0, 1, 2, 3, 4])
    assert alone.pvalue == signed_rank(first, second).pvalue
    with pytest.raises(ValueError, match="2 clusters for 5 pairs"):
        signed_rank(first, second, clusters=[0, 1])
