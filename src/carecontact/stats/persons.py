"""Intervals and tests that draw whole persons, not trials: exact sign flips, bootstrap, the worst share of persons."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.errors import counted
from carecontact.stats.proportions import unpaired_difference, wilson_interval
from carecontact.stats.ranks import SignFlip, sign_flip
from carecontact.stats.values import check_level, complete_pairs

GENERATOR_SEED = 20260
RESAMPLES = 10_000
Floats = npt.NDArray[np.float64]


def stratified_weights(strata: Sequence[Hashable], *, resamples: int = RESAMPLES) -> Floats:
    """(R, K) how much each of K persons counts in each resample; each row adds up to K.

    Of a stratum's n persons, n - 1 are drawn with replacement and count n / (n - 1) each: the bootstrap of Rao and Wu,
    JASA 83:231 (1988), whose variance is unbiased also for strata of two or three. Drawing n of n would give two
    thirds of the variance for three. Strata with a single person are taken together, which makes the interval rather
    too wide (collapsed strata: Cochran, Sampling Techniques, 1977, 5A.12); a last one alone joins the largest stratum.

    Args:
        strata: (K,) of each person, such as the body.

    Raises ValueError for fewer than two persons or resamples < 1.
    """
    if len(strata) < 2:
        raise ValueError(f"{counted(len(strata), 'person')}; expected at least 2")
    if resamples < 1:
        raise ValueError(f"resamples = {resamples}; expected at least 1")
    generator = np.random.default_rng(GENERATOR_SEED)
    weights = np.zeros((resamples, len(strata)))
    for members in _groups(strata):
        n = len(members)
        drawn = generator.multinomial(n - 1, np.full(n, 1.0 / n), size=resamples)
        weights[:, members] = drawn * (n / (n - 1))
    return weights


def strata_of(names: Sequence[int], strata: Mapping[int, Hashable] | None) -> list[Hashable]:
    """Return the stratum of each person; without strata all are in one. Raises ValueError for a person that has
    none."""
    if strata is None:
        return [0] * len(names)
    missing = [name for name in names if name not in strata]
    if missing:
        raise ValueError(f"person {missing[0]} has no stratum; expected one for each")
    return [strata[name] for name in names]


def _groups(strata: Sequence[Hashable]) -> list[list[int]]:
    """Indices of the persons of each stratum, two or more in each."""
    size = Counter(strata)
    alone = [i for i, stratum in enumerate(strata) if size[stratum] == 1]
    groups = [[i for i, s in enumerate(strata) if s == stratum] for stratum, n in size.items() if n > 1]
    if len(alone) == 1:
        largest = max(range(len(groups)), key=lambda g: len(groups[g]))
        groups[largest] = sorted(groups[largest] + alone)
    elif alone:
        groups.append(alone)
    return groups


@dataclass(frozen=True, kw_only=True)
class PersonRate:
    """k of n trials with an interval over persons. Without trials there is no estimate, and the interval is [0, 1]."""

    k: int
    n: int
    persons: int
    estimate: float | None
    low: float
    high: float
    confidence: float


@dataclass(frozen=True, kw_only=True)
class PersonDifference:
    """First rate minus second over the same trials. One person has no spread: no interval."""

    estimate: float | None
    """The difference; None without a trial."""
    low: float | None
    high: float | None
    n: int
    """Trials that both have."""
    persons: int
    test: SignFlip
    """Test that permutes whole persons."""
    confidence: float


def person_rate(
    passed: Sequence[bool],
    *,
    persons: Sequence[int],
    strata: Mapping[int, Hashable] | None = None,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> PersonRate:
    """Rate of all trials, with the percentile interval of ``stratified_weights``.

    Where every person has the same rate, resamples do not differ; the interval is then Wilson's for as many trials as
    there are persons, as if the trials of one person always had one outcome. One person says nothing about others,
    and the interval is [0, 1].

    Args:
        passed: (N,) of each trial.
        persons: (N,) the seed of each trial.
        strata: person -> stratum; None: one stratum.

    Raises ValueError for lengths that differ, a person without a stratum, or unless 0 < confidence < 1.
    """
    check_level("confidence", confidence)
    names, of_trial = _persons(passed, persons)
    values = np.asarray(passed, np.float64)
    n, k, people = len(values), int(values.sum()), len(names)
    if not n:
        return PersonRate(k=0, n=0, persons=0, estimate=None, low=0.0, high=1.0, confidence=confidence)
    got, of, low, high = np.bincount(of_trial, values, people), np.bincount(of_trial, minlength=people), 0.0, 1.0
    if people > 1 and np.ptp(got / of) == 0:
        wilson = wilson_interval(round(people * k / n), people, confidence)
        low, high = min(wilson.low, k / n), max(wilson.high, k / n)
    elif people > 1:
        weights = stratified_weights(strata_of(names, strata), resamples=resamples)
        low, high = _between((weights @ got) / (weights @ of), k / n, confidence)
    return PersonRate(k=k, n=n, persons=people, estimate=k / n, low=low, high=high, confidence=confidence)


def person_difference(
    first: Sequence[bool],
    second: Sequence[bool],
    *,
    persons: Sequence[int],
    strata: Mapping[int, Hashable] | None = None,
    confidence: float = 0.95,
) -> PersonDifference:
    """Difference of two rates over the same trials, with an interval and a test over persons.

    Interval as in ``person_rate``; where every person has the same difference, it is that of two independent samples of
    as many trials as there are persons (Newcombe). Raises ValueError as ``person_rate``.
    """
    check_level("confidence", confidence)
    if len(first) != len(second):
        raise ValueError(f"samples of {len(first)} and {len(second)}; expected pairs")
    names, of_trial = _persons(first, persons)
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    people, n = len(names), len(a)
    excess = np.bincount(of_trial, a - b, people)
    test = sign_flip([round(value) for value in excess.tolist()])
    estimate, low, high = float((a - b).mean()) if n else None, None, None
    if estimate is not None and people > 1:
        of = np.bincount(of_trial, minlength=people)
        if np.ptp(excess / of) == 0:
            alike = unpaired_difference(round(people * a.mean()), people, round(people * b.mean()), people, confidence)
            low, high = min(alike.low, estimate), max(alike.high, estimate)
        else:
            weights = stratified_weights(strata_of(names, strata))
            low, high = _between((weights @ excess) / (weights @ of), estimate, confidence)
    return PersonDifference(
        estimate=estimate, low=low, high=high, n=n, persons=people, test=test, confidence=confidence
    )


def _persons(values: Sequence[bool], persons: Sequence[int]) -> tuple[list[int], npt.NDArray[np.intp]]:
    """Persons in rising order, and (N,) the index of each trial's."""
    if len(values) != len(persons):
        raise ValueError(f"{len(persons)} persons for {len(values)} trials; expected one for each")
    names, of_trial = np.unique(np.asarray(persons, np.int64), return_inverse=True)
    return names.tolist(), of_trial


def _between(found: Floats, estimate: float, confidence: float) -> tuple[float, float]:
    low, high = np.quantile(found, [0.5 - confidence / 2, 0.5 + confidence / 2])
    return min(float(low), estimate), max(float(high), estimate)


Statistic = Literal["median_difference", "difference_of_medians", "difference_of_means"]
AT_ONCE = 2_000_000
"""Cells of the weight table that are held in memory at a time."""

ROUNDING = 1e-6
"""Largest error of sums of weights, whose steps are larger than 1."""
Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class BootstrapDifference:
    """First minus second, in the unit of the values. One cluster has no spread: no interval, no standard error."""

    statistic: Statistic
    estimate: float | None
    """None where no pair is complete."""
    low: float | None
    high: float | None
    standard_error: float | None
    """Standard deviation over the resamples."""
    n: int
    """Pairs in which both methods have a value; all others are left out."""
    n_clusters: int
    """Clusters with such a pair."""
    confidence: float
    resamples: int
    generator_seed: int


def clustered_bootstrap(
    first: Sequence[float | None],
    second: Sequence[float | None],
    *,
    clusters: Sequence[int],
    strata: Mapping[int, Hashable] | None = None,
    statistic: Statistic = "median_difference",
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> BootstrapDifference:
    """Percentile interval of a paired difference when whole clusters are drawn with replacement.

    Efron & Tibshirani, An Introduction to the Bootstrap (1993), ch. 13; clusters as in Davison & Hinkley, Bootstrap
    Methods (1997), 3.8. Percentile and not BCa, because the jackknife that BCa needs is inconsistent for medians. With
    few clusters (below about 10) such intervals are too narrow. Where the quantiles of a small sample leave the
    estimate out, the interval is stretched to it. Pass 0 and 1 and ``difference_of_means`` for rates.

    Args:
        first: (N,) values of the first method, None where NA.
        second: (N,) of the second, pair by pair.
        clusters: (N,) the seed of each pair.
        strata: cluster -> stratum, to draw as ``stratified_weights`` does; None: as many clusters as there are.
        statistic: ``median_difference`` is the median of the pairs' differences, the others compare the two samples.

    Raises ValueError for lengths that differ, NaN, infinity, a cluster without a stratum, resamples < 1 or unless 0 <
    confidence < 1.
    """
    if len(clusters) != len(first):
        raise ValueError(f"{len(clusters)} clusters for {len(first)} pairs; expected one for each")
    if resamples < 1:
        raise ValueError(f"resamples = {resamples}; expected at least 1")
    check_level("confidence", confidence)
    a_kept, b_kept, kept = complete_pairs(first, second)
    a, b = np.array(a_kept, np.float64), np.array(b_kept, np.float64)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a value is infinite; expected finite values")
    of_pair: Counts
    names, of_pair = np.unique(np.array([clusters[i] for i in kept], np.int64), return_inverse=True)
    n_clusters = len(names)
    estimate = low = high = spread = None
    if len(a):
        estimate = float(_statistic(a, b, of_pair, np.ones((1, n_clusters), np.int64), statistic)[0])
    if estimate is not None and n_clusters > 1:
        if strata is None:
            generator, alike = np.random.default_rng(GENERATOR_SEED), np.full(n_clusters, 1.0 / n_clusters)
            drawn = generator.multinomial(n_clusters, alike, size=resamples)
        else:
            groups = strata_of(names.tolist(), strata)
            drawn = stratified_weights(groups, resamples=resamples)
        step = max(1, AT_ONCE // len(a))
        parts = [_statistic(a, b, of_pair, drawn[i : i + step], statistic) for i in range(0, resamples, step)]
        found = np.concatenate(parts)
        low, high = _between(found, estimate, confidence)
        spread = float(found.std())
    return BootstrapDifference(
        statistic=statistic,
        estimate=estimate,
        low=low,
        high=high,
        standard_error=spread,
        n=len(a),
        n_clusters=n_clusters,
        confidence=confidence,
        resamples=resamples,
        generator_seed=GENERATOR_SEED,
    )


def _statistic(a: Floats, b: Floats, of_pair: Counts, times: Counts | Floats, statistic: Statistic) -> Floats:
    """(R,) the statistic of R resamples, in which cluster k is ``times[:, k]`` times."""
    match statistic:
        case "median_difference":
            return _medians(a - b, of_pair, times)
        case "difference_of_medians":
            return _medians(a, of_pair, times) - _medians(b, of_pair, times)
        case "difference_of_means":
            size = np.bincount(of_pair, minlength=times.shape[1])
            total = np.bincount(of_pair, weights=a - b, minlength=times.shape[1])
            return (times @ total) / (times @ size)


def _medians(values: Floats, of_pair: Counts, times: Counts | Floats) -> Floats:
    """(R,) medians of R resamples, found in the cumulated counts instead of in copies of the drawn values."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    reached = np.cumsum(times[:, of_pair[order]], axis=1)
    half = reached[:, -1:] / 2
    lower = ordered[np.argmax(reached > half - ROUNDING, axis=1)]
    upper = ordered[np.argmax(reached > half + ROUNDING, axis=1)]
    return (lower + upper) / 2


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
    names, of_trial = _persons(passed, persons)
    people, values = len(names), np.asarray(passed, np.float64)
    if not people:
        return WorstShare(estimate=None, low=None, high=None, by_chance=None, pvalue=None, share=share, persons=0)
    of = np.bincount(of_trial, minlength=people)
    rates = np.bincount(of_trial, values, people) / of
    estimate = float(_lowest(rates[None], np.ones((1, people)), share)[0])
    low = high = by_chance = pvalue = None
    if people > 1 and np.ptp(rates) > 0:
        weights = stratified_weights(strata_of(names, strata))
        low, high = _between(_lowest(rates[None], weights, share), estimate, confidence)
    if people > 1:
        drawn = _permuted(values, of_trial, tasks, people) / of
        alike = _lowest(drawn, np.ones((1, people)), share)
        by_chance, pvalue = float(alike.mean()), float((1 + (alike <= estimate + 1e-12).sum()) / (1 + PERMUTATIONS))
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


def _permuted(values: Floats, of_trial: npt.NDArray[np.intp], tasks: Sequence[Hashable], people: int) -> Floats:
    """(R, K) passed trials of each person after each task's outcomes were dealt again among its trials."""
    generator = np.random.default_rng(GENERATOR_SEED)
    total = np.zeros((PERMUTATIONS, people))
    of_task: defaultdict[Hashable, list[int]] = defaultdict(list)
    for trial, task in enumerate(tasks):
        of_task[task].append(trial)
    for trials in of_task.values():
        dealt = generator.permuted(np.tile(values[trials], (PERMUTATIONS, 1)), axis=1)
        np.add.at(total.T, of_trial[trials], dealt.T)
    return total
