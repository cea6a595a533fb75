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
    place: str, error: ValidationError, *, model: type[BaseModel], content: object, bases: Sequence[str] = ()
) -> str:
    """Return a line for each fault after ``place``. If the file could name one of ``bases``, fields left out share a
    line."""
    lines = faults(error, model=model, content=content)
    left_out = [found["type"] == "missing" and len(found["loc"]) == 1 for found in error.errors()]
    missing = [str(found["loc"][0]) for found, out in zip(error.errors(), left_out, strict=True) if out]
    if bases and len(missing) > 1:
        lines = [line for line, out in zip(lines, left_out, strict=True) if not out]
        if not any("(did you mean 'base'?)" in line for line in lines):
            lines.append(
                f'add base = "{bases[0]}" (valid: {", ".join(bases)}, FILE.toml), or give all fields; '
                f"{len(missing)} are missing: {', '.join(missing)}"
            )
    if len(lines) == 1:
        return f"{place}: {lines[0]}"
    return "\n  ".join([f"{place}: {counted(len(lines), 'field')} wrong", *lines])


def faults(error: ValidationError, *, model: type[BaseModel], content: object) -> list[str]:
    """Return one line for each wrong field of ``content``, in our own words; ``model`` says which fields exist."""
    lines: list[str] = []
    for found in error.errors():
        value, where, kind = found["input"], field_path(found["loc"], content), found["type"]
        shown = "" if isinstance(value, dict | list | tuple) else f" (got {str(value)[:INPUT_CHARACTERS]})"
        if kind == "extra_forbidden":
            *outer, name = found["loc"]
            names, valid = [part for part in outer if isinstance(part, str)], _fields(model, outer, content)
            table = f"the table {'.'.join(names)}" if names else "the file"
            listed = f"; valid: {', '.join(valid)}" if valid else ""
            fault = f"no such field in {table}{did_you_mean(str(name), valid)}{listed}"
        elif kind in WORDS:
            fault = WORDS[kind].format(**found.get("ctx", {}))
        else:
            fault = str(found["msg"]).removeprefix("Value error, ")
        # A check over several fields names its field in the message.
        lines.append(f"{where}: {fault}{shown}" if where else fault)
    return lines


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


def _fields(model: type[BaseModel], loc: Sequence[int | str], content: object) -> list[str]:
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
