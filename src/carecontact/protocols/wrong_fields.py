"""What a user's TOML file or option has wrong, field by field."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carecontact.protocols.field_words import field_path, words

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

INPUT_CHARACTERS = 80


def wrong_fields(
    place: str, error: ValidationError, *, model: type[BaseModel] | None = None, content: object = None
) -> str:
    """A heading that begins with ``place``, and one line for each fault; the arguments are those of ``faults``."""
    return "\n  ".join([f"{place}: {error.error_count()} field(s) wrong", *faults(error, model=model, content=content)])


def faults(error: ValidationError, *, model: type[BaseModel] | None = None, content: object = None) -> list[str]:
    """One line for each wrong field; a value is shown where it is one, not the table around a field that is missing.

    Args:
        model: what was expected; with it an unknown field lists those that exist.
        content: what was checked; with it a task is named by its id.
    """
    lines: list[str] = []
    for found in error.errors():
        value, where = found["input"], field_path(found["loc"], content)
        shown = "" if isinstance(value, dict | list | tuple) else f" (got {str(value)[:INPUT_CHARACTERS]})"
        said = words(found, model)
        # A check over several fields names its field in the message.
        lines.append(f"{where}: {said}{shown}" if where else said)
    return lines
