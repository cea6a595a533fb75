"""Finds where two values as sent over the wire differ, bit for bit, and by how much."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def differences(expected: Any, got: Any, place: str) -> list[tuple[str, str]]:
    """Return a pair of place and difference for every leaf of the maps and lists that differs: array, number or text.

    The list is empty if both values are equal to the last bit.
    """
    if isinstance(expected, dict) and isinstance(got, dict):
        out = [(f"{place}.{key}", "is present, but must not be") for key in sorted(got.keys() - expected.keys())]
        out += [(f"{place}.{key}", "is missing") for key in sorted(expected.keys() - got.keys())]
        for key in sorted(expected.keys() & got.keys()):
            out += differences(expected[key], got[key], f"{place}.{key}")
        return out
    if isinstance(expected, list | tuple) and isinstance(got, list | tuple) and len(expected) == len(got):
        return [
            found
            for index, (a, b) in enumerate(zip(expected, got, strict=True))
            for found in differences(a, b, f"{place}[{index}]")
        ]
    if isinstance(expected, np.ndarray) and isinstance(got, np.ndarray):
        told = _of_arrays(expected, got)
        return [(place, told)] if told else []
    if type(expected) is type(got) and (expected == got or (_is_nan(expected) and _is_nan(got))):
        return []
    return [(place, f"expected {expected!r:.100}, got {got!r:.100}")]


def _of_arrays(expected: np.ndarray, got: np.ndarray) -> str:
    if expected.dtype != got.dtype or expected.shape != got.shape:
        return f"expected {expected.dtype} {expected.shape}, got {got.dtype} {got.shape}"
    if expected.tobytes() == got.tobytes():
        return ""
    a, b = (np.ascontiguousarray(x).reshape(-1) for x in (expected, got))
    other = (a.view("u1").reshape(len(a), -1) != b.view("u1").reshape(len(b), -1)).any(1)
    with np.errstate(invalid="ignore"):
        away = np.abs(a[other].astype(np.float64) - b[other].astype(np.float64))
    finite = away[np.isfinite(away)]
    size = f", by up to {finite.max():.3g}" if finite.size else ""
    return f"{int(other.sum())} of {len(other)} numbers differ{size}"


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)
