"""Inheritance of protocol files: a file may name a ``base`` and state only what differs from it."""

from __future__ import annotations

import tomllib
from typing import Any

from carecontact.errors import ConfigError, did_you_mean
from carecontact.protocols.files import EARLIER, protocol_file, shipped_protocols

Table = dict[str, Any]

OWN = ("id", "description", "frozen")
"""Fields that are not inherited, so that every file has to state them. ``frozen`` is false where a file with a base
does not name it."""


def ancestry(name_or_path: str, *, heirs: tuple[str, ...] = ()) -> list[tuple[str, Table]]:
    """Return the files that a protocol is made of, each with its place and its own table, the first base first.

    A ``base`` is the id of a shipped protocol, or a file relative to the one that names it. Raises UnknownNameError, or
    ConfigError naming the file and what is wrong with it.
    """
    path = protocol_file(name_or_path)
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
    elif base not in shipped_protocols() and base not in EARLIER:
        valid = ", ".join([*shipped_protocols(), "FILE.toml"])
        raise ConfigError(
            f"{name_or_path}: base: no protocol named {base!r}{did_you_mean(base, shipped_protocols())}; valid: {valid}"
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
    """``own`` over ``base``: tables are merged key by key; every other value, lists and so ``tasks`` too, is replaced
    as a whole. A ``person.tissue_set`` brings its own rows, so those of the base go; and where another
    ``gates.set`` is named the base's gates go, whose fields mean something else."""
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
