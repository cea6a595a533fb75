"""How far scores spread over the draws of a sweep, and in how many draws two policies change places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from carecontact.reports.sweep.persons import Trials, trials_of
from carecontact.reports.table import headlines
from carecontact.scoring.metrics.metric import Metric
from carecontact.scoring.result import TrialScore

if TYPE_CHECKING:
    from carecontact.reports.sweep.table import CellScores

LOW, HIGH = 5.0, 95.0
"""Percentiles between which a band lies."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """The spread of one metric over the trials for which it is defined."""

    n: int
    low: float
    median: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Spread:
    """One policy in one task, over all combinations of the axes and all seeds."""

    policy: str
    task: str
    passed: int
    n: int
    bands: dict[str, Band | None]
    """Id of a headline metric -> its band; None where it is defined for no trial."""


@dataclass(frozen=True, kw_only=True)
class Flips:
    """Draws in which two policies stand the other way round than over all draws of one task."""

    a: str
    b: str
    task: str
    by: dict[str, tuple[int, int]]
    """``passed`` or the id of a headline metric -> such draws, of how many in which both have a number. Left out
    where the two are equal over all."""


@dataclass(frozen=True, kw_only=True)
class Bands:
    spreads: tuple[Spread, ...]
    flips: tuple[Flips, ...]


def bands(cells: Sequence[CellScores], outcome: str, *, ranked: Sequence[str]) -> Bands | None:
    """Return the spread of each metric over draws; None where no policy has two trials of a task. A *draw* is one
    combination of the axes' values and one seed.

    Args:
        outcome: field of a score that says whether a trial passed.
        ranked: policies of which it is asked whether they change places.
    """
    policies = list(dict.fromkeys(cell.label for cell in cells))
    found = {name: trials_of((c for c in cells if c.label == name), outcome, without=()) for name in policies}
    tasks = sorted({task for one in found.values() for _, task, _ in one.scores})
    alone = {(name, task): _of_task(one, task) for name, one in found.items() for task in tasks}
    spreads = [_spread(name, task, one) for (name, task), one in alone.items() if one.scores]
    if max((one.n for one in spreads), default=0) < 2:
        return None
    flips = [_flips(a, b, task, alone[a, task], alone[b, task]) for a, b in combinations(ranked, 2) for task in tasks]
    return Bands(spreads=tuple(spreads), flips=tuple(one for one in flips if one.by))


def _of_task(trials: Trials, task: str) -> Trials:
    return Trials(scores={key: s for key, s in trials.scores.items() if key[1] == task}, outcome=trials.outcome)


def _spread(policy: str, task: str, trials: Trials) -> Spread:
    bands = {metric.id: _band(metric.pooled(trials.scores.values())) for metric in headlines()}
    passed = sum(map(trials.passed, trials.scores))
    return Spread(policy=policy, task=task, passed=passed, n=len(trials.scores), bands=bands)


def _band(values: Sequence[float | None]) -> Band | None:
    valid = [value for value in values if value is not None]
    if not valid:
        return None
    low, median, high = map(float, np.percentile(valid, [LOW, 50.0, HIGH]))
    return Band(n=len(valid), low=low, median=median, high=high)


def _flips(a: str, b: str, task: str, of_a: Trials, of_b: Trials) -> Flips:
    keys = sorted(of_a.scores.keys() & of_b.scores.keys(), key=str)
    passed = [(float(of_a.passed(key)), float(of_b.passed(key))) for key in keys]
    by = {"passed": _reversed(passed, float(np.mean([x - y for x, y in passed])))} if passed else {}
    for metric in headlines():
        both = _both(metric, [of_a.scores[key] for key in keys], [of_b.scores[key] for key in keys])
        if both:
            x, y = np.median(both, axis=0)
            by[metric.id] = _reversed(both, float(x - y))
    return Flips(a=a, b=b, task=task, by={name: found for name, found in by.items() if found is not None})


def _both(metric: Metric, of_a: Sequence[TrialScore], of_b: Sequence[TrialScore]) -> list[tuple[float, float]]:
    pairs = zip(metric.pooled(of_a), metric.pooled(of_b), strict=True)
    return [(x, y) for x, y in pairs if x is not None and y is not None]


def _reversed(pairs: Sequence[tuple[float, float]], overall: float) -> tuple[int, int] | None:
    if overall == 0:
        return None
    return sum((x - y) * overall < 0 for x, y in pairs), len(pairs)
