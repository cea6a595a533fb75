from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from carecontact.errors import ConfigError
from carecontact.report import baselines
from carecontact.report.baselines import (
    Baselines,
    beside_baselines,
    beside_shipped_scores,
    completed_from_shipped_scores,
)
from carecontact.report.overview import overview, rank
from carecontact.runs import RunScores
from carecontact.runs.results_file import pack_results
from carecontact.scoring import TrialScore
from carecontact.stats import paired_difference, unpaired_difference, wilson_interval
from tests.report.synthetic import FAILED, NO_CONTACT, make_score


def passed(name: str, task: str, passed: list[bool], *, first_seed: int = 0) -> list[TrialScore]:
    return [make_score(task, first_seed + k, policy=name, **({} if ok else NO_CONTACT)) for k, ok in enumerate(passed)]


METHOD = RunScores(scores=passed("mine", "T1", [True] * 8 + [False] * 2) + passed("mine", "T6", [True] * 10))


def test_rates_and_paired_differences() -> None:
    """T1: the baseline passes 3, all of which the method passes, and one of the method's two failures."""
    baseline = RunScores(
        scores=passed("replay", "T1", [True] * 3 + [False] * 6 + [True])
        + passed("replay", "T6", [False] * 10)
        + passed("replay", "T7", [True] * 5)
    )
    beside = beside_baselines(METHOD, [baseline])
    assert beside.tasks == ("T1", "T6")
    (found,) = beside.baselines
    assert (found.policy, found.n, found.n_pairs) == ("replay", 20, 20)
    assert found.rates["success"] == wilson_interval(4, 20)
    assert found.per_task["T1"]["safety_gated"] == (4, 10)
    assert found.per_task["T6"]["success"] == (0, 10)
    assert found.above is not None
    assert found.above["success"] == paired_difference(both=3, only_first=15, only_second=1, neither=1)
    assert beside.method.rates["region_correct"] == wilson_interval(18, 20)
    assert beside.method.above is None


def test_rates_are_over_the_trials_that_both_have_and_the_whole_rate_is_kept() -> None:
    baseline = RunScores(scores=passed("replay", "T1", [True] * 3 + [False] * 7 + [True] * 20))
    (found,) = beside_baselines(METHOD, [baseline]).baselines
    assert (found.n, found.n_pairs, found.method_passed) == (10, 10, 8)
    assert found.rates["safety_gated"] == wilson_interval(3, 10)
    assert found.whole == wilson_interval(23, 30)
    assert found.per_task["T1"]["safety_gated"] == (3, 10)


def test_without_a_common_seed_the_difference_is_of_independent_trials() -> None:
    baseline = RunScores(scores=passed("random", "T1", [True, False, False], first_seed=50))
    (found,) = beside_baselines(METHOD, [baseline]).baselines
    assert found.n_pairs == 0
    assert found.above is not None
    assert found.above["safety_gated"] == unpaired_difference(18, 20, 1, 3)


def test_off_region_success_is_a_false_positive_of_success_alone() -> None:
    baseline = RunScores(scores=[make_score("T1", 0, policy="random", region_correct=False, safety_gated=False)])
    (found,) = beside_baselines(METHOD, [baseline]).baselines
    assert [rate.k for rate in found.rates.values()] == [1, 0, 0]


def test_trials_without_a_verdict_leave_the_counts_of_a_baseline_open() -> None:
    scores = passed("hover", "T1", [False] * 3)
    scores.append(make_score("T1", 7, policy="hover", **FAILED, ended="harness_error"))
    (found,) = beside_baselines(METHOD, [RunScores(scores=scores)], allow_incomplete=True).baselines
    assert (found.n, found.trials, found.count("safety_gated")) == (3, "3 of 4", "0 to 1 of 4")


@pytest.mark.parametrize(
    ("scores", "why"),
    [
        (passed("mine", "T1", [True]), "mine is also the policy"),
        (passed("hover", "T3", [True]), "hover ran none of the tasks T1, T6"),
        (
            [s.model_copy(update={"protocol_sha256": "1" * 64}) for s in passed("hover", "T1", [True])],
            "only runs of the same",
        ),
        ([], "the baseline has no trial"),
    ],
)
def test_what_is_no_baseline_is_refused(scores: list[TrialScore], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        beside_baselines(METHOD, [RunScores(scores=scores)])


def test_a_baseline_may_have_another_controller_but_no_other_world() -> None:
    """Where a policy commands joint angles, floor and ceiling still move the tool."""

    def of(run: list[TrialScore], **world: str) -> RunScores:
        return RunScores(scores=[s.model_copy(update={"world": world}) for s in run])

    method = of(METHOD.scores, control="joints", kernel="3")
    assert beside_baselines(method, [of(REPLAY, control="tool", kernel="3")]).floor["T1"].policy == "replay"
    with pytest.raises(ConfigError, match="different worlds: kernel"):
        beside_baselines(method, [of(REPLAY, control="joints", kernel="2")])


def test_a_registered_method_that_is_named_as_a_baseline_is_no_blind_baseline() -> None:
    scores = [score.model_copy(update={"policy": "state-machine", "policy_arguments": {}}) for score in METHOD.scores]
    found = beside_baselines(METHOD, [RunScores(scores=scores)])
    assert [row.role for row in found.baselines] == ["method"]
    assert not any(rate.blind for rate in found.floor.values())


REPLAY = passed("replay", "T1", [True] * 2 + [False] * 8) + passed("replay", "T6", [True] * 5 + [False] * 5)
MEAN = passed("mean-person", "T1", [True] * 4 + [False] * 6) + passed("mean-person", "T6", [False] * 10)
ORACLE = [s.model_copy(update={"privileged": True}) for s in passed("oracle", "T1", [True] * 10)]


def test_each_place_has_its_own_best_blind_arm() -> None:
    """A method and a ceiling that are named as baselines are no floor beside blind ones."""
    others = (REPLAY, MEAN, passed("state-machine", "T1", [True] * 10), ORACLE)
    floor = beside_baselines(METHOD, [RunScores(scores=scores) for scores in others]).floor
    found = {place: (best.policy, best.rate.k, best.rate.n) for place, best in floor.items()}
    assert found == {"all": ("replay", 7, 20), "T1": ("mean-person", 4, 10), "T6": ("replay", 5, 10)}


def test_of_blind_arms_that_pass_nothing_the_floor_is_one_that_does_something() -> None:
    idle, rough = passed("hover", "T1", [False] * 10), passed("mean-person", "T1", [False] * 10)
    rough = [rough[0].model_copy(update={"c3_success": True}), *rough[1:]]
    floor = beside_baselines(METHOD, [RunScores(scores=scores) for scores in (idle, rough)]).floor
    assert (floor["T1"].policy, floor["T1"].rate.k) == ("mean-person", 0)


def test_a_probe_and_a_ceiling_stand_beside_the_floor_and_are_not_it() -> None:
    probe = passed("feint-and-wait", "T1", [True] * 9 + [False])
    beside = beside_baselines(METHOD, [RunScores(scores=scores) for scores in (REPLAY, MEAN, probe, ORACLE)])
    assert [row.role for row in beside.baselines] == ["blind", "blind", "probe", "privileged"]
    assert {place: best.policy for place, best in beside.floor.items()} == {
        "all": "replay", "T1": "mean-person", "T6": "replay",
    }  # fmt: skip


def test_a_baseline_of_somebody_else_is_floor_and_not_called_blind() -> None:
    """It is not registered, so that nothing but its name under --baseline says what it is."""
    own = RunScores(scores=passed("my:Blind", "T1", [True] * 9 + [False]))
    beside = beside_baselines(METHOD, [own, RunScores(scores=REPLAY)])
    assert [row.role for row in beside.baselines] == ["method", "blind"]
    assert {place: (best.policy, best.blind) for place, best in beside.floor.items()} == {
        "all": ("my:Blind", False), "T1": ("my:Blind", False), "T6": ("replay", True),
    }  # fmt: skip
    assert not beside.only_blind


def test_a_registered_method_is_a_floor_only_where_nothing_is_blind_and_never_called_blind() -> None:
    method = RunScores(scores=passed("state-machine", "T1", [True] * 10))
    alone = beside_baselines(METHOD, [method])
    assert (alone.floor["all"].policy, alone.floor["all"].blind, alone.only_blind) == ("state-machine", False, False)
    beside = beside_baselines(METHOD, [method, RunScores(scores=REPLAY)])
    assert {best.policy for best in beside.floor.values()} == {"replay"}


@pytest.mark.parametrize(
    ("scores", "what"),
    [
        ([make_score("T1", k, policy="replay") for k in range(2)], "replay, which is a blind baseline"),
        ([make_score("T1", k, policy="feint-and-wait") for k in range(2)], "feint-and-wait, which is a probe"),
        (
            [make_score("T1", k, policy="x").model_copy(update={"privileged": True}) for k in range(2)],
            "x, .* privileged",
        ),
    ],
)
def test_only_methods_are_ranked(scores: list[TrialScore], what: str) -> None:
    methods = [RunScores(scores=[make_score("T1", k, policy=name) for k in range(2)]) for name in ("a", "b")]
    overview([*methods, RunScores(scores=[make_score("T1", k, policy="c") for k in range(2)])])
    with pytest.raises(ConfigError, match=f"C is {what}"):
        overview([*methods, RunScores(scores=scores)])


# The kept scores of the shipped policies stand beside every run of their protocol.

PROTOCOL = "bathing-v3"
PASSED = {"replay": 3, "state-machine": 7, "voxposer": 1}
"""Policy -> seeds of seven that it passes in both of its tasks."""
STALLED = FAILED | {"failure_mode": "insufficient_progress", "attribution": "planning", "evidence": "stroke 34 mm"}


def scores_of(policy: str, **fields: Any) -> RunScores:
    return RunScores(
        scores=[
            make_score(task, seed, policy=policy, **(fields | ({} if seed < PASSED[policy] else STALLED)))
            for task in ("T1", "T3")
            for seed in range(7)
        ]
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of kept scores. Those under another stiffness have a longer name, and belong to no run's side."""
    for policy in PASSED:
        place = tmp_path / PROTOCOL / f"{policy}.json.gz"
        place.parent.mkdir(exist_ok=True)
        pack_results(place, scores_of(policy))
    pack_results(tmp_path / PROTOCOL / "voxposer-1000.json.gz", scores_of("voxposer", overrides={"stiffness": "1000"}))
    return tmp_path


def test_kept_scores_of_the_protocol_stand_beside_a_run(folder: Path, tmp_path: Path) -> None:
    beside, why = beside_shipped_scores(scores_of("voxposer"), [], folders=[tmp_path / "nowhere", folder])
    assert beside is not None
    assert [row.policy for row in beside.baselines] == list(beside.kept) == ["replay", "state-machine"]
    assert beside.baselines[0].rates["safety_gated"].k == 6
    assert [row.role for row in beside.baselines] == ["blind", "method"]
    assert beside.floor["all"].policy == "replay", "a method is no floor, whatever it passes"
    assert why == ""


def test_a_named_run_stands_in_place_of_the_kept_one(folder: Path) -> None:
    beside, _ = beside_shipped_scores(scores_of("voxposer"), [scores_of("replay")], folders=[folder])
    assert beside is not None
    assert beside.baselines[0].policy == "replay"
    assert list(beside.kept) == ["state-machine"]


def test_kept_scores_of_another_world_do_not(folder: Path) -> None:
    beside, why = beside_shipped_scores(scores_of("voxposer", protocol_sha256="ab" * 32), [], folders=[folder])
    assert beside is None
    assert why.startswith("The kept scores of replay cannot stand beside this run: ")
    assert "same protocol" in why


def test_one_line_says_that_none_are_kept(tmp_path: Path) -> None:
    beside, why = beside_shipped_scores(scores_of("voxposer"), [], folders=[tmp_path])
    assert beside is None
    assert why == f"No scores of the shipped policies and the blind baselines are kept for {PROTOCOL}."
    assert beside_shipped_scores(RunScores(scores=[]), []) == (None, "")


def test_a_named_run_of_some_tasks_keeps_the_kept_trials_of_the_others(folder: Path) -> None:
    run, replay = scores_of("voxposer"), scores_of("replay")
    part = [s.model_copy(update={"safety_gated": False}) for s in replay.scores if s.task_id == "T1"]
    beside, _ = beside_shipped_scores(run, [RunScores(scores=part)], folders=[folder])
    assert beside is not None
    row = beside.baselines[0]
    assert (beside.completed, row.policy, row.n) == (("replay",), "replay", 14)
    assert {task: rates["safety_gated"] for task, rates in row.per_task.items()} == {"T1": (0, 7), "T3": (3, 7)}


def test_a_named_run_with_every_kept_trial_or_of_other_rules_stays_as_it_is(folder: Path) -> None:
    run, replay = scores_of("voxposer"), scores_of("replay")
    assert completed_from_shipped_scores(run, replay, folders=[folder]) is replay
    named = RunScores(scores=scores_of("replay", protocol_sha256="ab" * 32).scores[:1])
    assert completed_from_shipped_scores(run, named, folders=[folder]) is named


def test_the_rates_beside_a_run_are_computed_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def counted(method: RunScores, baselines: Sequence[RunScores], *, kept: Sequence[RunScores] = ()) -> Baselines:
        calls.append(len(kept))
        return beside_baselines(method, baselines, kept=kept)

    monkeypatch.setattr(baselines, "beside_baselines", counted)
    beside, _ = beside_shipped_scores(scores_of("voxposer"), [scores_of("replay")], folders=[folder])
    assert beside is not None
    assert calls == [len(beside.kept)]


def method(name: str, peaks_n: list[float], *, failures: int = 0, floor: int = 3) -> list[TrialScore]:
    """Successes of the given peaks on a segment that bears 100 N, then failures; ``floor``: level at the 1 N floor."""
    sweep = {"floor_n": {"0.5": 3, "1": floor}}
    rows = [
        make_score(
            "T1", seed, policy=name, peak_force_n={"right_forearm": peak}, gate_sweep=sweep,
            safety_gated=peak <= 35, over_limit={"right_forearm": peak / 35} if peak > 35 else {},
        )
        for seed, peak in enumerate(peaks_n)
    ]  # fmt: skip
    failed = {"gate_sweep": {"floor_n": {"0.5": 0, "1": 0}}} | FAILED
    return rows + [make_score("T1", len(rows) + k, policy=name, **failed) for k in range(failures)]


GENTLE = method("gentle", [10.0, 10.0, 10.0], failures=3, floor=0)
MIDDLE = method("middle", [30.0, 30.0], failures=4)
HARD = method("hard", [50.0] * 5 + [30.0], failures=0)


def test_order_turns_where_harder_presses_are_allowed() -> None:
    """Gated at 0.35: 3, 2 and 1 of 6. From 0.50 on hard has all 6."""
    found = rank({"gentle": GENTLE, "middle": MIDDLE, "hard": HARD})
    assert found.order == (("gentle",), ("middle",), ("hard",))
    assert found.shares["gamma 0.35"] == {"gentle": 0.5, "middle": pytest.approx(1 / 3), "hard": pytest.approx(1 / 6)}
    assert found.sweep.tau["gamma 0.35"].tau == pytest.approx(1.0)
    assert found.sweep.tau["gamma 1"].tau == pytest.approx(-1 / 3)
    assert found.sweep.tau["success"].tau == pytest.approx(-1 / 3)
    assert found.least_by_sweep()["gamma"] == (pytest.approx(-1 / 3), "gamma 0.5")
    assert found.least_by_sweep()["floor_n"][1] == "floor_n 1"


def test_equal_methods_share_a_place_and_order_nothing() -> None:
    found = rank({"one": MIDDLE, "two": MIDDLE})
    assert found.order == (("one", "two"),)
    assert found.sweep.least is None
    assert found.least_by_sweep()["gamma"] == (None, "")
