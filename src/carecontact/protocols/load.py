"""Load a protocol: one that ships, or a file, which may inherit from another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from carecontact.contract.protocol import Protocol, Tissue
from carecontact.errors import ConfigError
from carecontact.protocols import levels
from carecontact.protocols.files import shipped_protocols
from carecontact.protocols.inherit import Table, ancestry, inherit, merged
from carecontact.protocols.tissue_sets import load_tissue_set
from carecontact.protocols.wrong_fields import wrong_fields
from carecontact.regions import REGIONS, STANDARD_REGIONS

DEFAULT_PROTOCOL = "bathing-v3-draft"
ROW = {name for name, field in Tissue.model_fields.items() if field.is_required()}
"""Fields that a row of tissue must have."""


def load_protocol(name_or_path: str = DEFAULT_PROTOCOL, *, level: str | None = None) -> Protocol:
    """Return a shipped protocol by id, or a TOML file by path; docs/extending.md says how a file inherits.

    Args:
        level: one of the file's levels, where it has any (``protocols.levels``).

    Raises UnknownNameError, or ConfigError naming file, field and what was expected.
    """
    found = load_levels(name_or_path)
    if list(found) == [""]:
        if level is not None:
            raise ConfigError(f"{name_or_path} has no levels; leave level {level!r} out")
        return found[""]
    return found[levels.chosen(name_or_path, found, level)]


def load_levels(name_or_path: str) -> dict[str, Protocol]:
    """Return every level of a protocol by its name, or the protocol alone, named ``""``, where it has no levels. Raises
    as ``load_protocol`` does."""
    (place, table), *heirs = ancestry(name_or_path)
    found = _of_table(place, table, bases=sorted(shipped_protocols(), key=lambda name: name != DEFAULT_PROTOCOL))
    for heir, own in heirs:
        place, table = heir, inherit(table, own)
        found = _of_table(place, table)
    return found


def _of_table(place: str, table: Table, *, bases: Sequence[str] = ()) -> dict[str, Protocol]:
    """``bases``: see ``wrong_fields``."""
    rest, own = levels.split(place, table)
    if rest.get("overrides"):
        raise ConfigError(f"{place}: overrides are written by a command, never by a file; change the fields themselves")
    if rest.get("level"):
        raise ConfigError(f"{place}: level: a file has the tables [levels.NAME], and who loads it chooses one")
    if not own:
        return {"": _validated(place, rest, bases=bases)}
    whole = levels.tables(rest, own)
    return levels.knowing_each_other({name: _validated(f"{place}, level {name}", t) for name, t in whole.items()})


def merged_table(name_or_path: str) -> Table:
    """Return the table of a protocol's file over those of its bases, before anything is checked. Raises as
    ``ancestry``."""
    (_, table), *heirs = ancestry(name_or_path)
    for _, own in heirs:
        table = inherit(table, own)
    return table


def _validated(place: str, table: Table, *, bases: Sequence[str] = ()) -> Protocol:
    """``bases``: see ``wrong_fields``."""
    content = _with_neighbourhoods(_with_tissue(place, table))
    try:
        return Protocol.model_validate(content)
    except ValidationError as error:
        told = wrong_fields(place, error, model=Protocol, content=content, bases=bases)
        raise ConfigError(told) from None


def _with_tissue(place: str, table: Table) -> Table:
    """Return the rows of the tissue set that the file names, under what the file says of tissue itself."""
    person = table.get("person")
    if not isinstance(person, dict) or not isinstance(person.get("tissue_set"), str):
        return table
    own = person.get("tissue", {})
    soft = [name for name in (*STANDARD_REGIONS, *_task_regions(table)) if REGIONS[name].soft]
    # A file that spells out every row may give its set any name.
    if not isinstance(own, dict) or all(_is_whole(own.get(name)) for name in soft):
        return table
    try:
        rows = load_tissue_set(person["tissue_set"]).tissue
    except ConfigError as error:
        raise ConfigError(f"{place}: person.tissue_set: {error}") from None
    taken = {name: rows[name].model_dump() for name in soft if name in rows}
    return {**table, "person": {**person, "tissue": merged(taken, own)}}


def _is_whole(row: object) -> bool:
    return isinstance(row, dict) and row.keys() >= ROW


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
    named = [task.get("region") for task in tasks if isinstance(task, dict)] if isinstance(tasks, list) else []
    return list(dict.fromkeys(name for name in named if isinstance(name, str) and name in REGIONS))
