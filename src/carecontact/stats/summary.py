"""Summaries that say how many values they are over."""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Median:
    estimate: float | None
    """The estimate; None when no value is valid."""
    n_valid: int
    n: int


def median(values: Iterable[float | None]) -> Median:
    """Median of the values that are not NA (None). Raises ValueError on NaN, which is a fault and never NA."""
    everything = list(values)
    valid = [v for v in everything if v is not None]
    if any(v != v for v in valid):
        raise ValueError("a value is NaN; pass None for NA")
    return Median(estimate=statistics.median(valid) if valid else None, n_valid=len(valid), n=len(everything))
