"""Values of trials for statistics: which count, how they are summarised, and how a family of tests is corrected."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from operator import index
from typing import Any


def scipy_stats() -> Any:
    """Return the package, which takes a second to import and is therefore imported where it is used."""
    return import_module("scipy.stats")


# Checks on the samples of every statistic: they hold numbers, or None where a score does not exist.


def check_counts(k: int, n: int) -> tuple[int, int]:
    """``k`` of ``n`` as Python's whole numbers. Raises ValueError unless they are counts with 0 <= k <= n."""
    k, n = check_count("k", k), check_count("n", n)
    if k > n:
        raise ValueError(f"k = {k}, n = {n}; expected 0 <= k <= n")
    return k, n


def check_count(name: str, value: int) -> int:
    """``value`` as Python's whole number. Raises ValueError unless it is one from 0 up; True and False are none."""
    try:
        count = -1 if isinstance(value, bool) else index(value)
    except TypeError:
        count = -1
    if count < 0:
        raise ValueError(f"{name} = {value!r}; expected a whole number from 0 up")
    return count


def check_pairs(first: Sequence[float | None], second: Sequence[float | None]) -> None:
    """Raises ValueError unless the samples are as long as each other and free of NaN."""
    if len(first) != len(second):
        raise ValueError(f"samples of {len(first)} and {len(second)}; expected pairs")
    check_values(first)
    check_values(second)


def check_values(values: Sequence[float | None]) -> None:
    """Raises ValueError on NaN, which is a fault and never NA."""
    if any(value != value for value in values if value is not None):
        raise ValueError("a value is NaN; pass None for NA")


def complete_pairs(
    first: Sequence[float | None], second: Sequence[float | None]
) -> tuple[list[float], list[float], list[int]]:
    """Return both values of the pairs that have both, and the indices of those pairs."""
    check_pairs(first, second)
    kept = [(a, b, i) for i, (a, b) in enumerate(zip(first, second, strict=True)) if a is not None and b is not None]
    return [a for a, _, _ in kept], [b for _, b, _ in kept], [i for _, _, i in kept]


def check_level(name: str, value: float) -> None:
    """Raises ValueError unless 0 < value < 1."""
    if not 0 < value < 1:
        raise ValueError(f"{name} = {value}; expected between 0 and 1")


@dataclass(frozen=True, kw_only=True)
class Median:
    estimate: float | None
    """The estimate; None when no value is valid."""
    n_valid: int
    n: int


def median(values: Iterable[float | None]) -> Median:
    """Median of the values that are not NA (None). Raises ValueError on NaN, which is a fault and never NA."""
    everything = list(values)
    check_values(everything)
    valid = [v for v in everything if v is not None]
    return Median(estimate=statistics.median(valid) if valid else None, n_valid=len(valid), n=len(everything))


@dataclass(frozen=True, kw_only=True)
class Holm:
    adjusted: tuple[float | None, ...]
    """Adjusted p-values in the order given; None where there was no test."""
    n: int
    """Size of the family: how many tests were made."""


def holm(pvalues: Sequence[float | None]) -> Holm:
    """Step-down adjustment of Holm, Scandinavian Journal of Statistics 6:65 (1979).

    None stands for a test that could not be made; it does not count in the family. Raises ValueError for a value
    outside [0, 1].
    """
    for p in pvalues:
        if p is not None and not 0 <= p <= 1:
            raise ValueError(f"p = {p}; expected 0 <= p <= 1")
    made = sorted((p, i) for i, p in enumerate(pvalues) if p is not None)
    adjusted: list[float | None] = [None] * len(pvalues)
    largest = 0.0
    for rank, (p, i) in enumerate(made):
        largest = max(largest, min(1.0, (len(made) - rank) * p))
        adjusted[i] = largest
    return Holm(adjusted=tuple(adjusted), n=len(made))
