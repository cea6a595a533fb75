"""What arms that cannot do a task pass all the same: the floor under a method's rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carecontact.errors import ConfigError
from carecontact.reports.compare.comparison import check_comparable, trials_by_key
from carecontact.reports.compare.outcomes import RATES
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, RateDifference, paired_difference, unpaired_difference, wilson_interval


@dataclass(frozen=True, kw_only=True)
class Floor:
    """Rates by id: ``success``, ``region_correct``, ``safety_gated``."""

    policy: str
    n: int
    """Trials of the method's tasks, harness errors left out."""
    rates: dict[str, Proportion]
    """Of a null arm: its false positives."""
    per_task: dict[str, dict[str, tuple[int, int]]]
    """Task -> rate -> count and number of trials."""
    n_pairs: int | None = None
    """Trials of the same task and seed in both; None for the method itself."""
    above: dict[str, RateDifference] | None = None
    """Method minus arm, as fractions: by pairs, or between independent trials where there is no pair."""


@dataclass(frozen=True, kw_only=True)
class NullFloors:
    method: Floor
    nulls: tuple[Floor, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        return tuple(self.method.per_task)


def null_floors(method: RunScores, nulls: Sequence[RunScores]) -> NullFloors:
    """Set null arms beside a method, over the tasks that the method ran.

    Differences are Newcombe's (method 10, of pairs or of independent trials), rates Wilson's. Raises ConfigError,
    naming what differs, for another protocol, overrides, definitions or world, an arm that is the method itself or
    named twice, or one without a task in common.
    """
    seen = {method.scores[0].policy} if method.scores else set[str]()
    floors: list[Floor] = []
    for null in nulls:
        check_comparable({"the method": method.scores, "the null arm": null.scores})
        policy = null.scores[0].policy
        if policy in seen:
            raise ConfigError(f"--null: {policy} is the method or was named before; every arm once")
        seen.add(policy)
        floors.append(_floor(null.scores, method.scores))
    return NullFloors(method=_floor(method.scores, None), nulls=tuple(floors))


def _floor(scores: Sequence[TrialScore], method: Sequence[TrialScore] | None) -> Floor:
    counted = judged(scores)
    tasks = sorted({s.task_id for s in (counted if method is None else judged(method))})
    counted = [s for s in counted if s.task_id in tasks]
    if not counted:
        raise ConfigError(f"--null: {scores[0].policy} ran none of the tasks {', '.join(tasks)}")
    pairs: list[tuple[TrialScore, TrialScore]] = []
    if method is not None:
        of_method, of_arm = trials_by_key(method), trials_by_key(counted)
        pairs = [(of_method[key], of_arm[key]) for key in sorted(of_method.keys() & of_arm.keys())]
    return Floor(
        policy=scores[0].policy,
        n=len(counted),
        rates={rate.id: wilson_interval(_count(counted, rate.field), len(counted)) for rate in RATES},
        per_task={task: _of_task([s for s in counted if s.task_id == task]) for task in tasks},
        n_pairs=None if method is None else len(pairs),
        above=None
        if method is None
        else {rate.id: _difference(rate.field, pairs, judged(method), counted) for rate in RATES},
    )


def _of_task(scores: Sequence[TrialScore]) -> dict[str, tuple[int, int]]:
    return {rate.id: (_count(scores, rate.field), len(scores)) for rate in RATES}


def _difference(
    field: str,
    pairs: Sequence[tuple[TrialScore, TrialScore]],
    method: Sequence[TrialScore],
    arm: Sequence[TrialScore],
) -> RateDifference:
    if not pairs:
        return unpaired_difference(_count(method, field), len(method), _count(arm, field), len(arm))
    both, only_method, only_arm, neither = (
        sum((bool(getattr(m, field)), bool(getattr(a, field))) == want for m, a in pairs)
        for want in ((True, True), (True, False), (False, True), (False, False))
    )
    return paired_difference(both=both, only_first=only_method, only_second=only_arm, neither=neither)


def _count(scores: Sequence[TrialScore], field: str) -> int:
    return sum(bool(getattr(s, field)) for s in scores)
