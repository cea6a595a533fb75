"""Checks of what a program passes to a function: numbers, vectors and texts of a workable size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import numpy.typing as npt

from carecontact.policies.voxposer import fixed_values as fixed

F64 = npt.NDArray[np.float64]


def described(value: object) -> str:
    """Return what a value is in a program's own terms: the description of one of our objects, else the type's name."""
    return str(getattr(value, "description", type(value).__name__))


def shown(value: object) -> str:
    """Return a plain value as a program would write it, and one of our objects as ``described`` does."""
    return described(value) if hasattr(value, "description") else f"{value!r:.80}"


def number(value: object, what: str) -> float:
    """Return a number. Raises TypeError for another type, and ValueError unless it is finite and below 1e6."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{what}: expected a number, got {described(value)}")
    if not abs(value) < 1e6:
        raise ValueError(f"{what}: expected a finite number below 1e6, got {value!r:.40}")
    return float(value)


def numbers(value: object, count: int, what: str) -> F64:
    """Return ``count`` numbers as an array. Raises TypeError or ValueError as ``number`` does."""
    if not isinstance(value, list | tuple) or len(cast("Sequence[object]", value)) != count:
        raise TypeError(f"{what}: expected {count} numbers, got {shown(cast('object', value))}")
    return np.array([number(v, what) for v in cast("Sequence[object]", value)])


def text_of(query: object) -> str:
    """Return a text. Raises ValueError unless it has 1 to MAX_QUERY characters that are not all blank."""
    if not isinstance(query, str) or not query.strip() or len(query) > fixed.MAX_QUERY:
        got = repr(query[:80]) if isinstance(query, str) else f"{query!r:.80}"
        raise ValueError(f"expected a text of 1 to {fixed.MAX_QUERY} characters, got {got}")
    return query
