"""Two runs of known content: what is counted, refused and concluded."""

from __future__ import annotations

import json
from math import inf
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import ConfigError
from carecontact.report.comparison import Comparison, compare_runs
from carecontact.report.paired import RateLine, ScoreLine, plain_text
from carecontact.runs import RunScores
from carecontact.scoring.result import TrialScore
from tests.report.synthetic import FAILED, NO_CONTACT, make_score

HARNESS: dict[str, Any] = NO_CONTACT | {"ended": "harness_error", "failure_message": "no GPU"}


def run(*scores: TrialScore, policy: str = "b", **more: Any) -> RunScores:
    return RunScores(scores=[s.model_copy(update={"policy": policy}) for s in scores], **more)


def rate(comparison: Comparison, id_: str) -> RateLine:
    return next(line for line in comparison.overall if isinstance(line, RateLine) and line.outcome.id == id_)


def score(comparison: Comparison, id_: str) -> ScoreLine:
    return next(line for line in comparison.overall if isinstance(line, ScoreLine) and line.outcome.id == id_)


def grid(n_seeds: int, change: Any, tasks: tuple[str, ...] = ("T1", "T2", "T3")) -> list[TrialScore]:
    return [make_score(t, s, **change(t, s)) for s in range(n_seeds) for t in tasks]


def test_pairs_by_task_and_seed_and_says_what_is_left() -> None:
    a = run(make_score("T1", 0), make_score("T1", 1), make_score("T1", 2, **HARNESS), make_score("T3", 0), policy="a")
    b = run(
        make_score("T1", 1), make_score("T1", 0), make_score("T1", 2), make_score("T3", 0, **HARNESS),
        make_score("T2", 7), skipped={"T1-s004.h5": "truncated"},
    )  # fmt: skip
    a.scores.append(a.scores[0].model_copy(update={"seed": 4, "trial_id": "T1-s004"}))
    with pytest.raises(
        ConfigError, match=r"A is incomplete, 4 of 5 planned trials have a verdict \(the first without: T1"
    ):
        compare_runs(a, b)
    found = compare_runs(a, b, allow_incomplete=True)
    assert (found.pairing.n, found.pairing.tasks, found.pairing.seeds) == (2, ("T1",), (0, 1))
    assert found.pairing.unpaired_a == {"T1-s004": "recording skipped", "T3-s000": "harness failed"}
    assert found.pairing.unpaired_b == {"T1-s002": "harness failed", "T2-s007": "not in the run"}
    assert (found.a.policy, found.a.n_trials, found.a.n_planned, found.a.n_harness_errors) == ("a", 4, 5, 1)
    line = rate(found, "success")
    assert (line.n_pairs, line.a.n, line.unpaired_a.n, line.unpaired_b.n) == (2, 2, 3, 3)


def test_rates_by_hand() -> None:
    """Of 12 pairs 6 succeed in A alone, 2 in both, 4 in neither: McNemar 2 / 64."""
    a = run(*(make_score("T1", s, **({} if s < 8 else FAILED)) for s in range(12)), policy="a")
    b = run(*(make_score("T1", s, **({} if s in (0, 1) else FAILED)) for s in range(12)))
    line = rate(compare_runs(a, b), "success")
    assert (line.test.only_first, line.test.only_second, line.test.pvalue) == (6, 0, pytest.approx(2 / 64))
    assert (line.a.k, line.b.k, line.difference.estimate) == (8, 2, pytest.approx(0.5))
    assert line.clustered.estimate == pytest.approx(0.5)
    assert f"{line.unpaired.pvalue:.4f}" == "0.0361"


def test_the_funnel_is_compared_step_by_step() -> None:
    a = run(*(make_score("T1", s, safety_gated=s > 2, region_correct=s > 0) for s in range(4)), policy="a")
    found = compare_runs(a, run(*(make_score("T1", s) for s in range(4))))
    assert [rate(found, name).a.k for name in ("success", "region_correct", "safety_gated")] == [4, 3, 1]


def test_scores_rest_on_pairs_that_have_them_and_c2_on_push() -> None:
    a = run(
        make_score("T1", 0, c1_peak_force_n=10.0, c2_joint_margin_rad=-9.0),
        make_score("T1", 1, **NO_CONTACT),
        make_score("T2", 0, c1_peak_force_n=30.0, c2_joint_margin_rad=-0.5),
        policy="a",
    )
    b = run(
        make_score("T1", 0, c1_peak_force_n=4.0, c2_joint_margin_rad=9.0),
        make_score("T1", 1, c1_peak_force_n=1.0),
        make_score("T2", 0, c1_peak_force_n=20.0, c2_joint_margin_rad=-0.7),
    )
    found = compare_runs(a, b)
    c1, c2 = score(found, "C1"), score(found, "C2")
    assert (c1.a.estimate, c1.a.n_valid, c1.b.estimate, c1.b.n_valid) == (20.0, 2, 4.0, 3)
    assert (c1.difference.estimate, c1.difference.n) == (8.0, 2)
    assert (c1.n_only_a, c1.n_only_b, c1.n_neither) == (0, 1, 0)
    assert c1.worst_rank.better == "second"
    assert (c2.n_pairs, c2.a.estimate, c2.difference.estimate) == (1, -0.5, pytest.approx(0.2))
    without_push = compare_runs(run(make_score("T1", 0), policy="a"), run(make_score("T1", 0)))
    assert [line.outcome.id for line in without_push.overall] == [
        "success", "region_correct", "safety_gated", "C1", "C4", "C5",
    ]  # fmt: skip


def noisy(force: float, swing: float) -> Any:
    return lambda t, s: {"c1_peak_force_n": force + swing * ((7 * s + 3 * int(t[1])) % 11 - 5) / 5}


def test_verdict_higher() -> None:
    found = compare_runs(run(*grid(20, noisy(20, 2)), policy="a"), run(*grid(20, noisy(10, 1))))
    line = score(found, "C1")
    assert line.verdict is not None
    assert (line.verdict.word, line.verdict.text) == ("A higher", "A higher; lower is better")
    assert line.p_holm == pytest.approx(min(1.0, 7 * (line.test.pvalue or 1)))
    assert line.notes == ()


def test_verdict_no_difference_detected_says_what_would_have_been() -> None:
    b = grid(20, lambda t, s: {"c1_peak_force_n": 20.0 + ((5 * s + 2 * int(t[1])) % 13 - 6) / 6})
    line = score(compare_runs(run(*grid(20, noisy(20, 2)), policy="a"), run(*b)), "C1")
    assert line.verdict is not None
    assert line.verdict.word == "no difference detected"
    assert line.detectable is not None
    assert line.detectable.difference is not None
    assert 0 < line.detectable.difference < 5
    assert f"a difference of {line.detectable.difference:.2f} N would have been" in line.verdict.text


def test_verdict_underpowered() -> None:
    b = grid(20, lambda t, s: {"c1_peak_force_n": 40.0 * ((5 * s + 2 * int(t[1])) % 13) / 12})
    found = compare_runs(run(*grid(20, noisy(20, 2)), policy="a"), run(*b))
    line = score(found, "C1")
    assert line.verdict is not None
    assert line.detectable is not None
    assert line.verdict.text == (
        f"underpowered: this comparison could not have detected a difference below {line.detectable.difference:.2f} N"
    )
    few = compare_runs(run(*grid(2, noisy(20, 2)), policy="a"), run(*grid(2, noisy(19, 2))))
    assert {line.verdict.text for line in few.overall if line.verdict} == {
        "underpowered: this comparison could not have detected any difference"
    }


def test_verdict_where_no_pair_has_the_score() -> None:
    a = run(*(make_score("T1", s, **NO_CONTACT) for s in range(9)), policy="a")
    line = score(compare_runs(a, run(*(make_score("T1", s) for s in range(9)))), "C1")
    assert line.verdict is not None
    assert line.verdict.text == "underpowered: no pair has this score in both runs"
    assert (line.test.pvalue, line.p_holm, line.unpaired) == (None, None, None)
    assert line.notes == ("with no score counted as the worst score B is better",)


def test_few_seeds_give_no_claim_of_power() -> None:
    tasks = tuple(f"T{i}" for i in range(1, 8))
    a = run(*grid(4, noisy(20, 2), tasks), policy="a")
    b = run(*grid(4, lambda t, s: {"c1_peak_force_n": 20.0 + (s + int(t[1])) % 3 - 1}, tasks))
    line = score(compare_runs(a, b), "C1")
    assert line.verdict is not None
    assert line.verdict.text == "underpowered: from 4 seeds it is unknown what could have been detected"
    sure = score(compare_runs(a, run(*grid(4, noisy(10, 1), tasks))), "C1")
    assert sure.notes == ("based on only 4 seeds",)


def test_a_median_that_stands_still_gives_no_claim_of_power() -> None:
    tasks = tuple(f"T{i}" for i in range(1, 8))
    a = run(*grid(9, lambda t, s: {"c1_peak_force_n": 20.0 + s}, tasks), policy="a")
    b = run(*grid(9, lambda t, s: {"c1_peak_force_n": 20.0 + s + (s - 4 if t in ("T1", "T2") else 0)}, tasks))
    line = score(compare_runs(a, b), "C1")
    assert line.verdict is not None
    assert line.verdict.text == (
        "underpowered: where so many pairs are equal that no resample moves the median, it is unknown what could "
        "have been detected"
    )


def test_what_three_of_ten_seeds_give_is_stated() -> None:
    """A alone succeeds in all tasks of three seeds: 21 pairs to 0, but 2.8 % of the resamples miss all three."""
    tasks = tuple(f"T{i}" for i in range(1, 8))
    a = run(*grid(10, lambda t, s: {} if s < 3 else FAILED, tasks), policy="a")
    line = rate(compare_runs(a, run(*grid(10, lambda t, s: FAILED, tasks))), "success")
    assert line.verdict is not None
    assert line.verdict.word == "A higher"
    assert line.difference.low > 0
    assert line.clustered.low == 0
    assert line.notes == ("an interval that keeps a seed's tasks together does not exclude 0",)


def test_equal_runs() -> None:
    scores = grid(20, noisy(20, 2))
    found = compare_runs(run(*scores, policy="a"), run(*scores))
    assert {line.verdict.word for line in found.overall if line.verdict} == {"no difference detected"}
    assert {line.p_holm for line in found.overall} == {1.0}
    assert score(found, "C1").detectable is not None


def test_holm_families() -> None:
    a, b = run(*grid(8, noisy(20, 2)), policy="a"), run(*grid(8, noisy(10, 1)))
    found = compare_runs(a, b, per_task=True)
    assert found.per_task is not None
    assert compare_runs(a, b).per_task is None
    assert compare_runs(a, b).overall == found.overall
    assert {task: len(lines) for task, lines in found.per_task.items()} == {"T1": 6, "T2": 7, "T3": 6}
    line = next(line for line in found.per_task["T1"] if line.outcome.id == "C1")
    assert line.test.pvalue == pytest.approx(2 / 2**8)
    # All three tasks are as extreme, each against the 19 lines of the tasks.
    assert line.p_holm == pytest.approx(19 * 2 / 2**8)


@settings(deadline=None, max_examples=20)
@given(
    cells=st.lists(
        st.tuples(*[st.tuples(st.booleans(), st.one_of(st.none(), st.floats(1, 50)))] * 2), min_size=1, max_size=12
    ),
    shuffle=st.randoms(use_true_random=False),
)
def test_swapping_the_runs_mirrors_and_order_is_nothing(cells: Any, shuffle: Any) -> None:
    def side(k: int, policy: str) -> RunScores:
        scores = [
            make_score(f"T{1 + i % 2}", i // 2, c3_success=c[k][0], c1_peak_force_n=c[k][1])
            for i, c in enumerate(cells)
        ]
        return run(*scores, policy=policy)

    a, b = side(0, "a"), side(1, "b")
    found, swapped = compare_runs(a, b), compare_runs(b, a)
    shuffle.shuffle(a.scores)
    assert compare_runs(a, b) == found
    other = {"A higher": "B higher", "B higher": "A higher"}
    for line, mirror in zip(found.overall, swapped.overall, strict=True):
        assert line.verdict is not None
        assert mirror.verdict is not None
        assert mirror.verdict.word == other.get(line.verdict.word, line.verdict.word)
        assert mirror.p_holm == pytest.approx(line.p_holm)
        for p in (line.test.pvalue, line.p_holm):
            assert p is None or 0 <= p <= 1
        if line.difference.estimate is not None and line.difference.low is not None:
            assert line.difference.high is not None
            assert line.difference.low - 1e-9 <= line.difference.estimate <= line.difference.high + 1e-9
            assert mirror.difference.estimate == pytest.approx(-line.difference.estimate)
            assert mirror.difference.low == pytest.approx(-line.difference.high)


@pytest.mark.parametrize(
    ("change", "wording"),
    [
        ({"protocol_sha256": "1" * 64}, "A ran bathing-v3"),
        (
            {"protocol_sha256": "2" * 64, "overrides": {"person.body": "woman-old-light"}},
            r"B ran bathing-v3 with body woman-old-light \(2{12}\): only runs of the same protocol",
        ),
        ({"overrides": {"physics.dt_s": "0.004"}}, "with time step 0.004 s"),
        ({"metric_versions": {"contact": "contact-v2", "gates": "paper"}}, "contact contact-v1 and contact-v2"),
        ({"world": {"mujoco": "4.1.0", "body": "ab" * 32}}, r"mujoco 4.0.0 \(T1-s000 of run A\) and 4.1.0 \(T"),
        ({"seed": 3}, "A has T1 with seeds 0; B has T1 with seeds 3; run the same seeds"),
        ({"task_id": "T4"}, "no trial .* in common: A has T1 .*; B has T4"),
        (HARNESS, "B is incomplete, 0 of 1 planned trial has a verdict"),
    ],
)
def test_refusals_name_what_differs(change: dict[str, Any], wording: str) -> None:
    change = {"task_id": "T1", "seed": 0, **change}
    other = make_score(change.pop("task_id"), change.pop("seed"), **change)
    with pytest.raises(ConfigError, match=wording) as caught:
        compare_runs(run(make_score("T1", 0), policy="a"), run(other))
    assert "\n" not in str(caught.value)


def test_two_machines_are_compared_and_named() -> None:
    here, there = ({"arithmetic": name, "renderer": "llvmpipe"} for name in ("Haswell", "SkylakeX"))
    a = run(make_score("T1", 0, provenance=here), policy="a")
    assert compare_runs(a, run(make_score("T1", 0, provenance=here))).machines == ""
    assert compare_runs(a, run(make_score("T1", 0, provenance=there))).machines.startswith(
        "These runs may come from different machines: arithmetic Haswell (A), SkylakeX (B); another arithmetic"
    )


def test_json_is_plain_and_the_same_every_time() -> None:
    a = run(*(make_score("T1", s) for s in range(6)), policy="a")
    b = run(*(make_score("T1", s, **FAILED) for s in range(6)))
    found = compare_runs(a, b, per_task=True)
    line = rate(found, "success")
    assert line.unpaired.odds_ratio == inf
    text = json.dumps(found.as_json(), sort_keys=True, allow_nan=False)
    assert text == json.dumps(compare_runs(a, b, per_task=True).as_json(), sort_keys=True, allow_nan=False)
    data = json.loads(text)
    assert data["schema"] == "carecontact-comparison-2"
    assert data["overall"][0]["unpaired"]["odds_ratio"] is None
    assert data["overall"][0]["test"] == {"only_first": 6, "only_second": 0, "pvalue": pytest.approx(2 / 64)}
    assert data["overall"][0]["clustered"]["generator_seed"] == 20260
    assert data["protocol_sha256"] == a.scores[0].protocol_sha256


def test_digits() -> None:
    lines = compare_runs(run(make_score("T2", 0), policy="a"), run(make_score("T2", 0))).overall
    shown = {line.outcome.id: plain_text(line.outcome, 0.12345) for line in lines}
    assert shown == {
        "success": "12.3", "region_correct": "12.3", "safety_gated": "12.3",
        "C1": "0.12", "C2": "0.123", "C4": "0.123", "C5": "0.12",
    }  # fmt: skip
    assert plain_text(lines[0].outcome, None) == plain_text(lines[-1].outcome, None) == "NA"
