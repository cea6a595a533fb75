"""Lists the mistakes in a user's TOML file or option, field by field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from carecontact.errors import counted
from carecontact.protocols.field_words import field_path, words

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError
    from pydantic_core import ErrorDetails

INPUT_CHARACTERS = 80


def wrong_fields(
    place: str,
    error: ValidationError,
    *,
    model: type[BaseModel] | None = None,
    content: object = None,
    bases: Sequence[str] = (),
) -> str:
    """Return one line that begins with ``place`` where one field is wrong, else a heading and one line for each fault.

    Args:
        bases: what the file might have named as its ``base``, the likeliest first; empty if it has one or cannot. Of a
            file that could have one, the fields that it leaves out share a line.

    The other arguments are those of ``faults``.
    """
    lines = faults(error, model=model, content=content)
    left_out = [str(found["loc"][0]) if _is_left_out(found) else "" for found in error.errors()]
    missing = [name for name in left_out if name]
    if bases and len(missing) > 1:
        lines = [line for line, name in zip(lines, left_out, strict=True) if not name]
        if not any("(did you mean 'base'?)" in line for line in lines):
            lines.append(
                f'add base = "{bases[0]}" (valid: {", ".join(bases)}, FILE.toml), or give all fields; '
                f"{len(missing)} are missing: {', '.join(missing)}"
            )
    if len(lines) == 1:
        return f"{place}: {lines[0]}"
    return "\n  ".join([f"{place}: {counted(len(lines), 'field')} wrong", *lines])


def _is_left_out(found: ErrorDetails) -> bool:
    """Whether an error is that a field at the top of the file is missing."""
    return found["type"] == "missing" and len(found["loc"]) == 1


def faults(error: ValidationError, *, model: type[BaseModel] | None = None, content: object = None) -> list[str]:
    """Return one line for each wrong field; a value is shown where it is one, not the table around a field that is
    missing.

    Args:
        model: what was expected; with it an unknown field lists those that exist.
        content: what was checked; with it a task is named by its id.
    """
    lines: list[str] = []
    for found in error.errors():
        value, where = found["input"], field_path(found["loc"], content)
        shown = "" if isinstance(value, dict | list | tuple) else f" (got {str(value)[:INPUT_CHARACTERS]})"
        said = words(found, model, content)
        # A check over several fields names its field in the message.
        lines.append(f"{where}: {said}{shown}" if where else said)
    return lines
