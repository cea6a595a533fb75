"""Rates over persons: trials of one person belong together, and bodies are fixed strata."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.stats.differences import unpaired_difference
from carecontact.stats.proportions import wilson_interval
from carecontact.stats.sign_flip import SignFlip, sign_flip
from carecontact.stats.strata import GENERATOR_SEED, RESAMPLES, Floats, strata_of, stratified_weights
from carecontact.stats.values import check_level


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
    generator_seed: int = GENERATOR_SEED,
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
    got, of = np.bincount(of_trial, values, people), np.bincount(of_trial, minlength=people)
    low, high = 0.0, 1.0
    if people > 1 and np.ptp(got / of) == 0:
        wilson = wilson_interval(round(people * k / n), people, confidence)
        low, high = min(wilson.low, k / n), max(wilson.high, k / n)
    elif people > 1:
        weights = stratified_weights(strata_of(names, strata), resamples=resamples, generator_seed=generator_seed)
        low, high = _between((weights @ got) / (weights @ of), k / n, confidence)
    return PersonRate(k=k, n=n, persons=people, estimate=k / n, low=low, high=high, confidence=confidence)


def person_difference(
    first: Sequence[bool],
    second: Sequence[bool],
    *,
    persons: Sequence[int],
    strata: Mapping[int, Hashable] | None = None,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    generator_seed: int = GENERATOR_SEED,
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
    estimate = low = high = None
    if n:
        estimate = float((a - b).mean())
    if estimate is not None and people > 1:
        of = np.bincount(of_trial, minlength=people)
        if np.ptp(excess / of) == 0:
            alike = unpaired_difference(round(people * a.mean()), people, round(people * b.mean()), people, confidence)
            low, high = min(alike.low, estimate), max(alike.high, estimate)
        else:
            weights = stratified_weights(strata_of(names, strata), resamples=resamples, generator_seed=generator_seed)
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
