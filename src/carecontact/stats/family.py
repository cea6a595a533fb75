"""Adjusts the p-values of a family of tests, so that the whole family errs no more often than one test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


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
