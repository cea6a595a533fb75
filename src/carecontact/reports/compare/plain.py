"""Results of a comparison as JSON can hold them."""

from __future__ import annotations

from typing import Any


def plain(value: Any) -> Any:
    """Return the value as JSON can hold it: tuples become lists, infinity and NaN become None."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value
