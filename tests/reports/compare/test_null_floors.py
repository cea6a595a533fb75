from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.reports.compare.null_floors import null_floors
from carecontact.runs import RunScores
from carecontact.scoring import TrialScore
from carecontact.stats import paired_difference, unpaired_difference, wilson_interval
from tests.reports.synthetic_run import FAILED, NO_CONTACT, make_score


def arm(name: str, task: str, passed: list[bool], *, first_seed: int = 0) -> list[TrialScore]:
    return [
        make_score(task, first_seed + k, policy=name, **({} if ok else NO_CONTACT)) for k, ok in enumerate(passed)
    ]  # fmt: skip


METHOD = RunScores(scores=arm("mine", "T1", [True] * 8 + [False] * 2) + arm("mine", "T6", [True] * 10))


def test_rates_and_paired_differences() -> None:
    """T1: the arm passes 3, all of which the method passes, and one of the method's two failures."""
    null = RunScores(
        scores=arm("replay", "T1", [True] * 3 + [False] * 6 + [True]) + arm("replay", "T6", [False] * 10)
        + arm("replay", "T7", [True] * 5)
    )  # fmt: skip
    found = null_floors(METHOD, [null])
    assert found.tasks == ("T1", "T6")
    (floor,) = found.nulls
    assert (floor.policy, floor.n, floor.n_pairs) == ("replay", 20, 20)
    assert floor.rates["success"] == wilson_interval(4, 20)
    assert floor.per_task["T1"]["safety_gated"] == (4, 10)
    assert floor.per_task["T6"]["success"] == (0, 10)
    assert floor.above is not None
    assert floor.above["success"] == paired_difference(both=3, only_first=15, only_second=1, neither=1)
    assert found.method.rates["region_correct"] == wilson_interval(18, 20)
    assert found.method.above is None


def test_without_a_common_seed_the_difference_is_of_independent_trials() -> None:
    null = RunScores(scores=arm("random", "T1", [True, False, False], first_seed=50))
    (floor,) = null_floors(METHOD, [null]).nulls
    assert floor.n_pairs == 0
    assert floor.above is not None
    assert floor.above["safety_gated"] == unpaired_difference(18, 20, 1, 3)


def test_off_region_success_is_a_false_positive_of_success_alone() -> None:
    null = RunScores(scores=[make_score("T1", 0, policy="random", region_correct=False, safety_gated=False)])
    (floor,) = null_floors(METHOD, [null]).nulls
    assert [rate.k for rate in floor.rates.values()] == [1, 0, 0]


def test_harness_errors_are_in_no_rate() -> None:
    scores = arm("hover", "T1", [False] * 3)
    scores.append(make_score("T1", 7, policy="hover", **FAILED, ended="harness_error"))
    assert null_floors(METHOD, [RunScores(scores=scores)]).nulls[0].n == 3


@pytest.mark.parametrize(
    ("scores", "why"),
    [
        (arm("mine", "T1", [True]), "mine is the method"),
        (arm("hover", "T3", [True]), "hover ran none of the tasks T1, T6"),
        ([s.model_copy(update={"protocol_sha256": "1" * 64}) for s in arm("hover", "T1", [True])], "only runs of one"),
        ([], "the null arm has no trial"),
    ],
)
def test_what_is_no_floor_is_refused(scores: list[TrialScore], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        null_floors(METHOD, [RunScores(scores=scores)])
