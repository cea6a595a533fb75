"""Write the table of a protocol as TOML; the standard library only reads it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

Table = Mapping[str, Any]


def toml_text(table: Table) -> str:
    """TOML that reads back as this table, with the values of each table before the tables inside it. A value that is
    None is left out: TOML has no word for it, and for a field it means that the file does not give it."""
    return "\n".join(_lines(table, ())).strip() + "\n"


def _lines(table: Table, place: tuple[str, ...]) -> list[str]:
    given = {name: value for name, value in table.items() if value is not None}
    lines = [f"{_key(name)} = {_value(value)}" for name, value in given.items() if not _has_own_head(value)]
    for name, value in given.items():
        inside = (*place, name)
        head = ".".join(map(_key, inside))
        if isinstance(value, Mapping):
            below = _lines(value, inside)
            lines += ["", *([] if value and all(map(_has_own_head, value.values())) else [f"[{head}]"]), *below]
        elif _has_own_head(value):
            for entry in value:
                lines += ["", f"[[{head}]]", *_lines(entry, inside)]
    return lines


def _has_own_head(value: object) -> bool:
    """Whether a value is a table or a list of tables."""
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list) and bool(value) and all(isinstance(entry, Mapping) for entry in value)


def _value(value: object) -> str:
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for characters beyond the basic plane, which stand as they are.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {_value(child)}" for name, child in value.items()) + " }"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    return str(value)


def _key(name: str) -> str:
    plain = name.isascii() and name.replace("-", "").replace("_", "").isalnum()
    return name if plain else _value(name)
