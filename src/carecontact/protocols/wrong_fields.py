"""What a user's TOML file has wrong, field by field."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

INPUT_CHARACTERS = 80


def wrong_fields(place: str, error: ValidationError) -> str:
    """One line a field; a value is shown where it is one, not the table around a field that is missing."""
    lines = [f"{place}: {error.error_count()} field(s) wrong"]
    for found in error.errors():
        value, where = found["input"], ".".join(map(str, found["loc"])) or "together"
        shown = "" if isinstance(value, dict | list) else f" (got {str(value)[:INPUT_CHARACTERS]})"
        lines.append(f"  {where}: {found['msg'].removeprefix('Value error, ')}{shown}")
    return "\n".join(lines)
