"""Levels of a protocol file: tables ``[levels.NAME]`` that state what changes from one level to the next.

The first level is the file without its levels, with the first table over it; every other level is the one before it,
with its own table over that. A person of a seed is the same on all levels, so each level knows what the others draw.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from carecontact.contract.protocol import Alive, Level, Protocol
from carecontact.errors import ConfigError, did_you_mean
from carecontact.protocols.inherit import OWN, Table, merged

LEVELS = "levels"
OWN_OF_FILE = (*OWN, "base", "level", LEVELS, "tasks", "gates", "contact", "limits", "overrides")
"""Fields that no level may change: the identity of the protocol, its tasks, and what counts as success."""


def split(place: str, table: Table) -> tuple[Table, dict[str, Table]]:
    """Split the table of a file into the table without levels and the tables of the levels.

    Raises ConfigError naming the table that is not one, or a field in it that no level can change.
    """
    levels = table.get(LEVELS, {})
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
    return rest, {str(name): dict(own) for name, own in levels.items()}


def tables(rest: Table, levels: Mapping[str, Table]) -> dict[str, Table]:
    """Return the whole table of every level, in the order of the file."""
    out: dict[str, Table] = {}
    for name, own in levels.items():
        rest = merged(rest, own)
        out[name] = rest
    return out


def knowing_each_other(found: Mapping[str, Protocol]) -> dict[str, Protocol]:
    """Return every level with its name and with what all of them draw."""
    shared = {
        name: Level(variation=rules.variation, reposition_m=_farthest_m(rules.person.alive))
        for name, rules in found.items()
    }
    return {name: rules.model_copy(update={"level": name, LEVELS: shared}) for name, rules in found.items()}


def chosen(place: str, found: Mapping[str, Any], level: str | None) -> str:
    """Return the name of a level that a file has. Raises ConfigError, which lists them, for none and for another."""
    valid = ", ".join(found)
    if level is None:
        raise ConfigError(f"{place} has the levels {valid}; choose one with level")
    if level not in found:
        raise ConfigError(f"{place}: no level named {level!r}{did_you_mean(level, found)}; valid: {valid}")
    return level


def _farthest_m(alive: Alive) -> float:
    return 0.0 if alive.repositioning is None else alive.repositioning.wrist_m[1]
