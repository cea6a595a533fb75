"""Reads a protocol's file with its base and its levels, and writes one as TOML."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from carecontact.errors import ConfigError, UnknownNameError, did_you_mean
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.protocol.field_errors import wrong_fields
from carecontact.protocol.overrides import load_tissue_set
from carecontact.protocol.person import Tissue
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Level

DEFAULT_PROTOCOL, DEFAULT_LEVEL, DEFAULT_SEEDS = "bathing-wide-v2", "L2", "0-2"
"""What every command and ``evaluate`` take where nothing else is named: the exam, with three seeds for development."""
Table = dict[str, Any]
OWN = ("id", "description", "frozen")
"""Fields that are not inherited, so that every file has to state them. ``frozen`` is false where a file with a base
does not name it."""
LEVELS = "levels"
OWN_OF_FILE = (*OWN, "base", "level", LEVELS, "tasks", "gates", "contact", "limits", "overrides")
"""Fields that no level may change: the identity of the protocol, its tasks, and what counts as success."""
ROW = {name for name, field in Tissue.model_fields.items() if field.is_required()}
"""Fields that a row of tissue must have."""
EARLIER = {
    "bathing-v1": "7076c1d2648cc214270a946eadef89bfea3d74bf",
    "bathing-moved-v1": "5eab211a09649f150689eb92f0bf99efe21019bb",
    "bathing-v2": "663c7e2317bf04e7b79c6a85d596936bd4fd816c",
    "bathing-wide-v1": "663c7e2317bf04e7b79c6a85d596936bd4fd816c",
}
"""Protocol that this release no longer has -> the commit that reproduces its results (CHANGELOG.md)."""


def shipped_protocols() -> list[str]:
    """Return ids of the protocols that come with carecontact."""
    folder = resources.files("carecontact.protocol")
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def protocol_file(name_or_path: str) -> Path:
    """Return the file of a shipped or own protocol. Raises UnknownNameError or ConfigError."""
    if commit := EARLIER.get(name_or_path):
        raise ConfigError(
            f"no protocol named {name_or_path!r}: commit {commit} has it, and reproduces its results; valid here: "
            f"{', '.join(shipped_protocols())}"
        )
    if name_or_path in shipped_protocols():
        return Path(str(resources.files("carecontact.protocol") / f"{name_or_path}.toml"))
    if not name_or_path.endswith(".toml"):
        if Path(f"{name_or_path}.toml").is_file():
            raise ConfigError(f"no protocol named {name_or_path!r} (did you mean {name_or_path}.toml?)")
        raise UnknownNameError("protocol", name_or_path, shipped_protocols())
    if not Path(name_or_path).is_file():
        raise ConfigError(f"protocol file {name_or_path} does not exist")
    return Path(name_or_path)


# Inheritance: a file may name a ``base`` and state only what differs from it.


def ancestry(name_or_path: str, *, heirs: tuple[str, ...] = ()) -> list[tuple[str, Table]]:
    """Return place and own table of each file that a protocol is made of, the first base first."""
    path, shipped = protocol_file(name_or_path), shipped_protocols()
    try:
        table = tomllib.loads(path.read_bytes().decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{name_or_path}: not TOML: {error}") from None
    base = table.pop("base", None)
    if base is None:
        return [(name_or_path, table)]
    if not isinstance(base, str):
        raise ConfigError(f"{name_or_path}: base: expected the id of a protocol or a .toml file, got {base!s:.80}")
    if base.endswith(".toml"):
        base = str(path.parent / base)
    elif base not in (*shipped, *EARLIER):
        meant = did_you_mean(base, shipped)
        raise ConfigError(
            f"{name_or_path}: base: no protocol named {base!r}{meant}; valid: {', '.join(shipped)}, FILE.toml"
        )
    line = (*heirs, str(path.resolve()))
    try:
        file = protocol_file(base)
    except ConfigError as error:
        raise ConfigError(f"{name_or_path}: base: {error}") from None
    if str(file.resolve()) in line:
        raise ConfigError(f"{name_or_path}: base: {base} inherits from this file itself")
    return [*ancestry(base, heirs=line), (name_or_path, table)]


def inherit(base: Table, own: Table) -> Table:
    """``own`` over ``base``, key by key; lists are replaced whole. Rows of tissue go with another ``tissue_set``, gates
    with another ``set``."""
    kept = {name: value for name, value in base.items() if name not in OWN}
    person, own_person = kept.get("person"), own.get("person")
    if isinstance(person, dict) and isinstance(own_person, dict) and "tissue_set" in own_person:
        kept["person"] = {name: value for name, value in person.items() if name != "tissue"}
    gates, own_gates = kept.get("gates"), own.get("gates")
    if isinstance(gates, dict) and isinstance(own_gates, dict) and "set" in own_gates:
        kept["gates"] = gates if gates.get("set") == own_gates["set"] else {}
    return {"frozen": False, **merged(kept, own)}


def merged(base: Table, own: Table) -> Table:
    """``own`` over ``base``, table by table."""
    out = dict(base)
    for name, value in own.items():
        before = out.get(name)
        out[name] = merged(before, value) if isinstance(before, dict) and isinstance(value, dict) else value
    return out


# Levels: tables ``[levels.NAME]`` that state what changes from one level to the next.
#
# The first level is the file without its levels, with the first table over it; every other level is the one before it,
# with its own table over that. A person of a seed is the same on all levels, so each level knows what the others draw.


def by_level(place: str, table: Table) -> dict[str, Table]:
    """Return the whole table of every level, in the order of the file; without levels, it is named ``""``."""
    levels, out = table.get(LEVELS, {}), dict[str, Table]()
    rest = {name: value for name, value in table.items() if name != LEVELS}
    if not isinstance(levels, Mapping):
        raise ConfigError(f"{place}: {LEVELS}: expected tables [{LEVELS}.NAME], got {levels!s:.40}")
    for name, own in levels.items():
        if not isinstance(own, Mapping):
            raise ConfigError(f"{place}: {LEVELS}.{name}: expected a table, got {own!s:.40}")
        if not name.replace("-", "").isalnum():
            raise ConfigError(f"{place}: {LEVELS}.{name}: expected a name of letters, digits and -")
        if fixed := next((field for field in own if field in OWN_OF_FILE), None):
            raise ConfigError(
                f"{place}: {LEVELS}.{name}.{fixed}: a level cannot change {fixed}, which all levels share"
            )
        rest = merged(rest, dict(own))
        out[name] = rest
    return out or {"": rest}


def load_protocol(name_or_path: str, *, level: str | None = None) -> Protocol:
    """Return a shipped protocol by id, or a TOML file by path, at one of the file's levels, where it has any; without a
    name of one at L2. docs/evidence/extending.md describes how a file inherits.

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
    found = load_levels(name_or_path)
    valid = ", ".join(found)
    if list(found) == [""]:
        if level is not None:
            raise ConfigError(f"{name_or_path} has no levels; leave level {level!r} out")
        return found[""]
    if level is None and DEFAULT_LEVEL not in found:
        raise ConfigError(f"{name_or_path} has the levels {valid}; choose one with level")
    level = level or DEFAULT_LEVEL
    if level not in found:
        raise ConfigError(f"{name_or_path}: no level named {level!r}{did_you_mean(level, found)}; valid: {valid}")
    return found[level]


def load_levels(name_or_path: str) -> dict[str, Protocol]:
    """Return every level of a protocol by its name, or the protocol alone, named ``""``, where it has no levels."""
    found, bases = dict[str, Protocol](), sorted(shipped_protocols(), key=lambda name: name != DEFAULT_PROTOCOL)
    for place, table in _inherited(name_or_path):
        found, bases = _of_table(place, table, bases=bases), []  # only the first one could name a base
    return found


def merged_table(name_or_path: str) -> Table:
    """Return the table of a protocol's file over those of its bases, before anything is checked."""
    *_, (_, table) = _inherited(name_or_path)
    return table


def _inherited(name_or_path: str) -> Iterator[tuple[str, Table]]:
    """Yield place and whole table of each file that a protocol is made of, the first base first."""
    whole: Table | None = None
    for place, own in ancestry(name_or_path):
        whole = own if whole is None else inherit(whole, own)
        yield place, whole


def _of_table(place: str, table: Table, *, bases: Sequence[str]) -> dict[str, Protocol]:
    levels = by_level(place, table)
    if table.get("overrides"):
        raise ConfigError(f"{place}: overrides are written by a command, never by a file; change the fields themselves")
    if table.get("level"):
        raise ConfigError(f"{place}: level: a file has the tables [levels.NAME], and who loads it chooses one")
    if "" in levels:
        return {"": _validated(place, levels[""], bases=bases)}
    found = {name: _validated(f"{place}, level {name}", whole) for name, whole in levels.items()}
    shared: dict[str, Level] = {}
    for name, rules in found.items():
        moves = rules.person.alive.repositioning
        shared[name] = Level(variation=rules.variation, reposition_m=0.0 if moves is None else moves.wrist_m[1])
    return {name: rules.model_copy(update={"level": name, LEVELS: shared}) for name, rules in found.items()}


def _validated(place: str, table: Table, *, bases: Sequence[str] = ()) -> Protocol:
    content = _with_neighbourhoods(_with_tissue(place, table))
    try:
        return Protocol.model_validate(content)
    except ValidationError as error:
        raise ConfigError(wrong_fields(place, error, model=Protocol, content=content, bases=bases)) from None


def _with_tissue(place: str, table: Table) -> Table:
    """Return the rows of the tissue set that the file names, under what the file says of tissue itself."""
    person = table.get("person")
    if not isinstance(person, dict) or not isinstance(person.get("tissue_set"), str):
        return table
    own = person.get("tissue", {})
    soft = [name for name in (*STANDARD_REGIONS, *_task_regions(table)) if REGIONS[name].soft]
    # A file that spells out every row may give its set any name.
    if not isinstance(own, dict) or all(isinstance(own.get(name), dict) and own[name].keys() >= ROW for name in soft):
        return table
    try:
        rows = load_tissue_set(person["tissue_set"]).tissue
    except ConfigError as error:
        raise ConfigError(f"{place}: person.tissue_set: {error}") from None
    taken = {name: rows[name].model_dump() for name in soft if name in rows}
    return {**table, "person": {**person, "tissue": merged(taken, own)}}


def _with_neighbourhoods(table: Table) -> Table:
    """Fill in the regions' own neighbourhoods where the file has none for a region of its tasks."""
    contact = table.get("contact")
    if not isinstance(contact, dict) or not isinstance(contact.get("neighbourhood", {}), dict):
        return table
    own: dict[str, Any] = contact.get("neighbourhood", {})
    missing = {name: list(REGIONS[name].neighbourhood) for name in _task_regions(table) if name not in own}
    return {**table, "contact": {**contact, "neighbourhood": {**own, **missing}}} if missing else table


def _task_regions(table: Table) -> list[str]:
    """Registered regions of the file's tasks; what is not of the expected form is left for the schema to report."""
    tasks = table.get("tasks")
    named = [task.get("region") for task in (tasks if isinstance(tasks, list) else []) if isinstance(task, dict)]
    return list(dict.fromkeys(name for name in named if isinstance(name, str) and name in REGIONS))


# Writing TOML, which the standard library only reads.


def toml_text(table: Mapping[str, Any]) -> str:
    """TOML that reads back as this table. A value that is None is left out: TOML has no word for it."""
    return "\n".join(_lines(table, ())).strip() + "\n"


def _lines(table: Mapping[str, Any], place: tuple[str, ...]) -> list[str]:
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
