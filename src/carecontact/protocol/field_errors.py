"""Explains a wrong field of a TOML file in words: what was expected, what was got, and what may have been meant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args

from pydantic import BaseModel

from carecontact.errors import counted, did_you_mean
from carecontact.protocol.gates import ACTIONS, Gates
from carecontact.protocol.protocol import Protocol

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails


WORDS = {
    "missing": "missing; give it a value",
    "greater_than": "expected more than {gt}",
    "greater_than_equal": "expected at least {ge}",
    "less_than": "expected less than {lt}",
    "less_than_equal": "expected at most {le}",
    "finite_number": "expected a finite number",
    "literal_error": "expected {expected}",
    "too_short": "expected at least {min_length} of them, got {actual_length}",
    "too_long": "expected at most {max_length} of them, got {actual_length}",
    "string_too_short": "expected at least {min_length} characters",
    "string_too_long": "expected at most {max_length} characters",
    "string_pattern_mismatch": "expected letters, digits, - and _ alone ({pattern})",
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type"), "expected a table"),
    **dict.fromkeys(("tuple_type", "list_type"), "expected a list in brackets"),
    "string_type": "expected text in quotes",
    **dict.fromkeys(("bool_type", "bool_parsing"), "expected true or false"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "expected a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "expected a number"),
}
"""Type of an error of pydantic -> the sentence for it; names in braces are filled in from the error's context."""
WRITTEN = ("level", "overrides")
"""Fields of a protocol that carecontact fills in and a file must not give."""
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
    """Return one line for each wrong field, without words of pydantic. A value is shown where it is one, not the table
    around a field that is missing.

    Args:
        model: what was expected; with it an unknown field lists those that exist.
        content: what was checked; with it a task is named by its id, and the version of the gates gives their fields.
    """
    lines: list[str] = []
    for found in error.errors():
        value, where, kind = found["input"], field_path(found["loc"], content), found["type"]
        shown = "" if isinstance(value, dict | list | tuple) else f" (got {str(value)[:INPUT_CHARACTERS]})"
        if kind == "extra_forbidden":
            fault = _unknown(found["loc"], model, content)
        elif kind in WORDS:
            fault = WORDS[kind].format(**found.get("ctx", {}))
        else:
            fault = str(found["msg"]).removeprefix("Value error, ")
        # A check over several fields names its field in the message.
        lines.append(f"{where}: {fault}{shown}" if where else fault)
    return lines


def _unknown(loc: Sequence[int | str], model: type[BaseModel] | None, content: object) -> str:
    names, valid = [part for part in loc[:-1] if isinstance(part, str)], _fields(model, loc[:-1], content)
    table = f"the table {'.'.join(names)}" if names else "the file"
    listed = f"; valid: {', '.join(valid)}" if valid else ""
    return f"no such field in {table}{did_you_mean(str(loc[-1]), valid)}{listed}"


def field_path(loc: Sequence[int | str], content: object) -> str:
    """``tasks.T1.action`` for the first of the file's tasks; an entry without an id is named by its number from 1."""
    parts: list[str] = []
    for part in loc:
        inside: Any = None
        if isinstance(content, Mapping):
            inside = content.get(part)
        elif isinstance(content, list) and isinstance(part, int) and part < len(content):
            inside = content[part]
        own = inside.get("id") if isinstance(inside, Mapping) and isinstance(part, int) else None
        parts.append(own if isinstance(own, str) else str(part + 1) if isinstance(part, int) else part)
        content = inside
    return ".".join(parts)


def _fields(model: type[BaseModel] | None, loc: Sequence[int | str], content: object) -> list[str]:
    """Return names of the fields of the table at a place; none where the place is not a table of fixed fields."""
    if model is Protocol and not loc:
        return ["base", *(name for name in Protocol.model_fields if name not in WRITTEN)]
    gates: Any = content.get("gates") if isinstance(content, Mapping) else None
    chosen = str(gates.get("set")) if isinstance(gates, Mapping) else ""
    here: Any = model
    for part in loc:
        if isinstance(part, int) and isinstance(here, type) and issubclass(here, BaseModel):
            continue  # an entry of the list whose tables were found with its name
        if here is Gates:
            here = ACTIONS[str(part)].gate_in(chosen) if part in ACTIONS else None
        elif isinstance(here, type) and issubclass(here, BaseModel):
            field = here.model_fields.get(str(part))
            here = None if field is None else field.annotation
        inner = [kind for kind in get_args(here) if kind not in (NoneType, Ellipsis)]
        tables = [kind for kind in inner if isinstance(kind, type) and issubclass(kind, BaseModel)]
        if isinstance(part, int) or (tables and not isinstance(here, type)):
            here = tables[0] if tables else None
    return list(here.model_fields) if isinstance(here, type) and issubclass(here, BaseModel) else []
