"""How the least served persons fare: the mean rate of the lowest share of them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.stats.strata import GENERATOR_SEED, RESAMPLES, Floats, stratified_weights
from carecontact.stats.values import check_level

DECILE = 0.1
PERMUTATIONS = 2_000


@dataclass(frozen=True, kw_only=True)
class WorstShare:
    """Mean rate of the persons with the lowest rates. One person has no spread: no interval, no chance."""

    estimate: float | None
    """The estimate; None without a trial."""
    low: float | None
    high: float | None
    by_chance: float | None
    """What to expect if every person were alike: the mean over permutations of each task's outcomes among persons."""
    pvalue: float | None
    """One-sided: share of those permutations whose worst persons fare no better than the found ones."""
    share: float
    persons: int


def worst_share(
    passed: Sequence[bool],
    *,
    persons: Sequence[int],
    tasks: Sequence[Hashable],
    strata: Mapping[int, Hashable] | None = None,
    share: float = DECILE,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    permutations: int = PERMUTATIONS,
    generator_seed: int = GENERATOR_SEED,
) -> WorstShare:
    """Mean of the persons' rates over the lowest ``share`` of them.

    Of 27 persons a tenth is 2.7: the two lowest, and the third with a weight of 0.7. Of fewer than ten, it is the
    lowest one alone. The lowest of noisy rates are partly bad luck, and the more so the fewer trials a person has:
    ``by_chance`` says how low they would be without any difference between persons. The interval is from
    ``stratified_weights``; there is none where all persons have the same rate.

    Args:
        passed: (N,) of each trial.
        persons: (N,) the seed of each trial.
        tasks: (N,) the task of each trial.

    Raises ValueError for lengths that differ or a share or confidence outside (0, 1).
    """
    check_level("share", share)
    check_level("confidence", confidence)
    if not len(passed) == len(persons) == len(tasks):
        raise ValueError(f"{len(passed)} trials, {len(persons)} persons, {len(tasks)} tasks; expected as many of each")
    names, of_trial = np.unique(np.asarray(persons, np.int64), return_inverse=True)
    people, values = len(names), np.asarray(passed, np.float64)
    if not people:
        return WorstShare(estimate=None, low=None, high=None, by_chance=None, pvalue=None, share=share, persons=0)
    of = np.bincount(of_trial, minlength=people)
    rates = np.bincount(of_trial, values, people) / of
    estimate = float(_lowest(rates[None], np.ones((1, people)), share)[0])
    low = high = by_chance = pvalue = None
    if people > 1 and np.ptp(rates) > 0:
        groups = [0] * people if strata is None else [strata[name] for name in names.tolist()]
        weights = stratified_weights(groups, resamples=resamples, generator_seed=generator_seed)
        found = np.quantile(_lowest(rates[None], weights, share), [0.5 - confidence / 2, 0.5 + confidence / 2])
        low, high = min(float(found[0]), estimate), max(float(found[1]), estimate)
    if people > 1:
        drawn = _permuted(values, of_trial, tasks, people, permutations, generator_seed) / of
        alike = _lowest(drawn, np.ones((1, people)), share)
        by_chance, pvalue = float(alike.mean()), float((1 + (alike <= estimate + 1e-12).sum()) / (1 + permutations))
    return WorstShare(
        estimate=estimate, low=low, high=high, by_chance=by_chance, pvalue=pvalue, share=share, persons=people
    )


def _lowest(rates: Floats, weights: Floats, share: float) -> Floats:
    """(R,) mean of the lowest share of the persons' weight; rates and weights (R or 1, K). The lowest person that is
    there counts as one at least."""
    rates, weights = np.broadcast_arrays(rates, weights)
    order = np.argsort(rates, axis=1, kind="stable")
    ordered, here = (np.take_along_axis(values, order, axis=1) for values in (rates, weights))
    target = np.maximum(share * here.sum(axis=1, keepdims=True), 1.0)
    before = np.cumsum(here, axis=1) - here
    taken = np.clip(target - before, 0.0, here)
    return (taken * ordered).sum(axis=1) / taken.sum(axis=1)


def _permuted(
    values: Floats, of_trial: npt.NDArray[np.intp], tasks: Sequence[Hashable], people: int, times: int, seed: int
) -> Floats:
    """(R, K) passed trials of each person after each task's outcomes were dealt anew among its trials."""
    generator = np.random.default_rng(seed)
    total = np.zeros((times, people))
    of_task: dict[Hashable, list[int]] = {}
    for trial, task in enumerate(tasks):
        of_task.setdefault(task, []).append(trial)
    for trials in of_task.values():
        dealt = generator.permuted(np.tile(values[trials], (times, 1)), axis=1)
        np.add.at(total.T, of_trial[trials], dealt.T)
    return total
