"""Protocols in which one factor of a hard level is switched on alone, or off alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import BaseModel

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.protocols import overridden

AXIS = "factor"
"""Name of the axis in tables."""
NONE, ALL = "none", "all"
"""The easy level, and the hard one."""
Fields = Mapping[str, object]
"""Dotted path -> value."""


def alone(factor: str) -> str:
    """Return the value of AXIS for the easy level with this factor alone."""
    return f"only {factor}"


def without(factor: str) -> str:
    """Return the value of AXIS for the hard level without this factor."""
    return f"all but {factor}"


def factor_protocols(
    low: Protocol, high: Protocol, groups: Mapping[str, Sequence[str]], *, place: str
) -> dict[str, Protocol]:
    """Value of AXIS -> its protocol: the two levels, and for each factor the easy one with it and the hard one without.

    Args:
        groups: factor -> the dotted fields that belong together; every other field in which the levels differ is a
            factor of its own, named by its last part.
        place: how messages name the plan's table.

    Raises ConfigError, which begins with ``place``, for a field in which the levels do not differ, two factors of one
    name, and a mixture that is no valid protocol.
    """
    easy, hard = _fields(low), _fields(high)
    differ = [path for path in hard if hard[path] != easy.get(path)]
    for factor, paths in groups.items():
        for path in paths:
            if path not in differ:
                valid = ", ".join(differ) or "none"
                raise ConfigError(f"{place}.{factor}: the levels do not differ in {path!r}; they do in: {valid}")
    grouped = {path for paths in groups.values() for path in paths}
    named: dict[str, Sequence[str]] = dict(groups)
    for path in differ:
        name = path.rpartition(".")[2]
        if path not in grouped:
            if name in named:
                raise ConfigError(f"{place}: two factors are named {name!r}; put {path} into a group of another name")
            named[name] = [path]
    if not named:
        raise ConfigError(f"{place}: the levels are the same")
    found = {NONE: low}
    found |= {alone(factor): _mixed(low, hard, paths, f"{place}.{factor}") for factor, paths in named.items()}
    found[ALL] = high
    found |= {without(factor): _mixed(high, easy, paths, f"{place}.{factor}") for factor, paths in named.items()}
    return found


def _mixed(protocol: Protocol, other: Fields, paths: Sequence[str], place: str) -> Protocol:
    try:
        return overridden(protocol, {path: other[path] for path in paths})
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from None


def _fields(protocol: Protocol) -> dict[str, object]:
    """Dotted path -> value of every field of a table, those of what the person does by itself one by one."""
    tables: dict[str, BaseModel] = {
        name: table for name in Protocol.model_fields if isinstance(table := getattr(protocol, name), BaseModel)
    }
    tables["person.alive"] = protocol.person.alive
    return {
        path: getattr(table, field)
        for name, table in tables.items()
        for field in type(table).model_fields
        if (path := f"{name}.{field}") not in tables
    }
