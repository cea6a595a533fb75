"""What a user's TOML file or option has wrong, field by field."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

INPUT_CHARACTERS = 80


def wrong_fields(place: str, error: ValidationError) -> str:
    """A heading that begins with ``place``, and one line for each fault."""
    return "\n  ".join([f"{place}: {error.error_count()} field(s) wrong", *faults(error)])


def faults(error: ValidationError) -> list[str]:
    """One line for each wrong field; a value is shown where it is one, not the table around a field that is missing."""
    lines: list[str] = []
    for found in error.errors():
        value, where = found["input"], ".".join(map(str, found["loc"]))
        shown = "" if isinstance(value, dict | list) else f" (got {str(value)[:INPUT_CHARACTERS]})"
        said = found["msg"].removeprefix("Value error, ")
        # A check over several fields names its field in the message.
        lines.append(f"{where}: {said}{shown}" if where else said)
    return lines
