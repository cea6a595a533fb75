from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.reports.compare.baselines import beside_baselines
from carecontact.runs import RunScores
from carecontact.scoring import TrialScore
from carecontact.stats import paired_difference, unpaired_difference, wilson_interval
from tests.reports.synthetic_run import FAILED, NO_CONTACT, make_score


def passed(name: str, task: str, passed: list[bool], *, first_seed: int = 0) -> list[TrialScore]:
    return [
        make_score(task, first_seed + k, policy=name, **({} if ok else NO_CONTACT)) for k, ok in enumerate(passed)
    ]  # fmt: skip


METHOD = RunScores(scores=passed("mine", "T1", [True] * 8 + [False] * 2) + passed("mine", "T6", [True] * 10))


def test_rates_and_paired_differences() -> None:
    """T1: the baseline passes 3, all of which the method passes, and one of the method's two failures."""
    baseline = RunScores(
        scores=passed("replay", "T1", [True] * 3 + [False] * 6 + [True]) + passed("replay", "T6", [False] * 10)
        + passed("replay", "T7", [True] * 5)
    )  # fmt: skip
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


def test_a_registered_method_that_is_named_as_a_baseline_is_no_blind_baseline() -> None:
    scores = [score.model_copy(update={"policy": "state-machine", "policy_arguments": {}}) for score in METHOD.scores]
    found = beside_baselines(METHOD, [RunScores(scores=scores)])
    assert [row.role for row in found.baselines] == ["method"]
    assert not any(rate.blind for rate in found.floor.values())
