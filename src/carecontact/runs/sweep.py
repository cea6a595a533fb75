"""The plan of a sweep: which policies run under which protocols and changes, as one run for each combination."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from carecontact.errors import ConfigError, did_you_mean
from carecontact.protocol.field_errors import wrong_fields
from carecontact.protocol.load import DEFAULT_LEVEL, DEFAULT_PROTOCOL, DEFAULT_SEEDS, load_levels, load_protocol
from carecontact.protocol.overrides import SKIN_STATES, overridden
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.runs.identity import check_frozen
from carecontact.runs.manifest import with_salt
from carecontact.runs.plan import check_protocol, check_rows, parse_seeds, parse_tasks, plan_trials, with_noise_salt

AXIS = "factor"
NONE, ALL = "none", "all"
"""The easy level, and the hard one."""
Fields = Mapping[str, object]
"""Dotted path -> value."""


def only_factor(factor: str) -> str:
    """Return the value of AXIS for the easy level with this factor alone."""
    return f"only {factor}"


def without_factor(factor: str) -> str:
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
    """
    easy, hard = _fields(low, high), _fields(high, low)
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
    found = {}
    for whole, begin, other, title in ((NONE, low, hard, only_factor), (ALL, high, easy, without_factor)):
        found[whole] = begin
        for factor, paths in named.items():
            with _at(f"{place}.{factor}"):
                found[title(factor)] = overridden(begin, {path: other[path] for path in paths})
    return found


@contextmanager
def _at(place: str) -> Iterator[None]:
    """Let the message of a ConfigError begin with a place of the plan."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from None


def _fields(protocol: Protocol, other: Protocol) -> dict[str, object]:
    """Dotted path -> value of every field of a table, those of what the person does by itself one by one. A table that
    only one of the two protocols has is one field.
    """
    tables = {name: (getattr(protocol, name), getattr(other, name)) for name in Protocol.model_fields}
    tables["person.alive"] = (protocol.person.alive, other.person.alive)
    found: dict[str, object] = {}
    for name, (table, others) in tables.items():
        if isinstance(table, BaseModel) and isinstance(others, BaseModel):
            fields = {f"{name}.{field}": getattr(table, field) for field in type(table).model_fields}
            found |= {path: value for path, value in fields.items() if path not in tables}
        elif isinstance(table, BaseModel) or isinstance(others, BaseModel):
            found[name] = table
    return found


Value = str | int | float | bool
Values = Annotated[list[Value], Field(min_length=1)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PlannedPolicy(_Table):
    """A policy with the options that ``carecontact run`` has for it."""

    policy: Annotated[str, Field(min_length=1)]
    label: str = ""
    """Name in the tables; default: the policy with its arguments."""
    arguments: dict[str, Value] = {}
    environment: list[str] = []
    read: list[str] = []
    write: list[str] = []
    language: str | None = None
    jobs: Annotated[int | None, Field(ge=1)] = None
    """Most trials of this policy at once, such as the connections that its server takes; default: no limit."""


class PlannedFactors(_Table):
    """Two levels, and in between each factor switched on alone and off alone (``factor_protocols``)."""

    low: str
    high: str
    groups: dict[str, Values] = {}
    """Factor -> the dotted fields that belong together; every other field in which the two differ is its own factor."""


class Plan(_Table):
    """Every policy runs the same tasks and seeds for every combination of the axes' values."""

    tasks: str = "all"
    seeds: str = DEFAULT_SEEDS
    rank_by: Literal["safety_gated", "region_correct", "success"] = "safety_gated"
    """What the order of the policies is read from: the share of such trials."""
    policies: Annotated[list[PlannedPolicy], Field(min_length=1)]
    axes: dict[str, Values] = {}
    """Axis -> its values: ``protocol``, ``level``, one of AXES, or the dotted name of any field of the protocol."""
    factors: PlannedFactors | None = None
    """Takes the place of the axes ``protocol`` and ``level``."""
    set: dict[str, Value] = {}
    """Field of the protocol -> value in place of its own, in every combination."""

    @property
    def protocols(self) -> list[str]:
        return [str(name) for name in self.axes.get("protocol", [f"{DEFAULT_PROTOCOL} {DEFAULT_LEVEL}"])]

    @property
    def levels(self) -> list[str | None]:
        """The levels of every protocol; a plan of protocols without levels names none."""
        return [str(name) for name in self.axes["level"]] if "level" in self.axes else [None]


AXES = {
    "body": "person.body",
    "tissue": "person.tissue_set",
    "stiffness": "impedance.translational_n_m",
    "friction": "person.tissue.REGION.friction",
    "latency_ms": "phases.latency_s",
}
"""Short name of an axis -> the field that it varies; that of friction is there for every soft region."""


def read_plan(path: Path) -> Plan:
    """Raises ConfigError naming file, field and what was expected."""
    try:
        content: dict[str, Any] = tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise ConfigError(f"plan {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"plan {path}: not TOML: {error}") from None
    try:
        plan = Plan.model_validate(content)
    except ValidationError as error:
        raise ConfigError(wrong_fields(f"plan {path}", error, model=Plan, content=content)) from None
    if plan.factors is not None and (axis := next((name for name in ("protocol", "level") if name in plan.axes), None)):
        raise ConfigError(f"plan {path}: factors: they stand in place of axes.{axis}; give only one")
    for axis, values in plan.axes.items():
        if twice := [value for k, value in enumerate(values) if value in values[:k]]:
            raise ConfigError(f"plan {path}: axes.{axis}: {twice[0]!r} is there twice; name each value once")
        if AXES.get(axis, axis) in plan.set:
            raise ConfigError(f"plan {path}: set.{AXES.get(axis, axis)}: the axis {axis} varies it; give only one")
    return plan


CELLS = "cells"
"""Folder of a sweep, below which every cell has its own."""
NAME_CHARACTERS = 100
DIGEST_CHARACTERS = 8
NAME_LEVELS = 'name levels in axes.level, or each beside its protocol, such as "bathing-wide-v2 L0"'


@dataclass(frozen=True, kw_only=True)
class Place:
    """One combination of the axes' values, in which every policy runs."""

    values: dict[str, str]
    """Axis -> value, as tables show it."""
    protocol: Protocol
    tasks: tuple[str, ...]
    seeds: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run of a plan: a policy in a place."""

    policy: int
    label: str
    """The policy's name in tables."""
    place: Place
    specs: tuple[TrialSpec, ...]

    @property
    def name(self) -> str:
        """Name of the cell's folder: readable, and the same in every plan that has this cell."""
        first = self.specs[0]
        whole = [first.policy, first.policy_arguments, first.policy_environment, first.protocol.sha256, self.label]
        digest = hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:DIGEST_CHARACTERS]
        texts = [re.sub(r"[^A-Za-z0-9.-]+", "-", text) for text in (self.label, *self.place.values.values())]
        return f"{'_'.join(texts).strip('-.')[:NAME_CHARACTERS]}_{digest}"


def places_of(plan: Plan, *, named: str) -> list[Place]:
    """Return every combination, in the order of the plan's axes. ``named``: how messages name the plan."""
    axes = [name for name in plan.axes if name not in ("protocol", "level")]
    places: list[Place] = []
    for shown, whole in _bases(plan, named):
        with _at(f"plan {named}: set"):
            rules = overridden(whole, plan.set)
        for axis in axes:
            with _at(f"plan {named}: axes.{axis}"):
                for value in plan.axes[axis]:
                    along = _along(rules, axis, value)
                    check_protocol(along)
                    check_rows(along)
        with _at(f"plan {named}"):
            tasks, seeds = parse_tasks(plan.tasks, protocol=rules), parse_seeds(plan.seeds, protocol=rules)
        for values in product(*(plan.axes[axis] for axis in axes)):
            chosen = dict(zip(axes, values, strict=True))
            texts = {axis: _text(value) for axis, value in chosen.items()}
            made = rules
            with _at(f"plan {named}: {', '.join(f'{axis} = {text}' for axis, text in texts.items())}"):
                # The tissue first: its rows have frictions of their own.
                for axis, value in sorted(chosen.items(), key=lambda pair: pair[0] != "tissue"):
                    made = _along(made, axis, value)
            places.append(Place(values=shown | texts, protocol=made, tasks=tuple(tasks), seeds=tuple(seeds)))
    return places


def _bases(plan: Plan, named: str) -> list[tuple[dict[str, str], Protocol]]:
    """Return what the other axes are varied on, with the value of its own axis where it has one."""
    if plan.factors is not None:
        place = f"plan {named}: factors"
        with _at(place):
            low, high = (_loaded(name) for name in (plan.factors.low, plan.factors.high))
        groups = {name: [str(path) for path in paths] for name, paths in plan.factors.groups.items()}
        found = factor_protocols(low, high, groups, place=place)
        return [({AXIS: value}, protocol) for value, protocol in found.items()]
    found = []
    for name, level in product(plan.protocols, plan.levels):
        shown = {"protocol": name} if "protocol" in plan.axes else {}
        if level is not None:
            shown["level"] = level
        with _at(f"plan {named}: axes.{'protocol' if level is None else 'level'}"):
            found.append((shown, _loaded(name, level=level)))
    return found


def _loaded(name: str, *, level: str | None = None) -> Protocol:
    """Return a protocol as titles name it: its id or file, and its level after a space where it has levels."""
    whole, _, titled = name.partition(" ") if not name.endswith(".toml") else (name, "", "")
    wanted = level or titled or None
    levels = ", ".join(filter(None, load_levels(whole)))
    if bool(levels) != bool(wanted):
        known = f"has the levels {levels}" if levels else f"has no levels, and so no {wanted}"
        raise ConfigError(f"{whole} {known}; {NAME_LEVELS}")
    return check_frozen(whole, load_protocol(whole, level=wanted), unfrozen=False)


def cells_of(
    plan: Plan,
    places: Sequence[Place],
    policies: Sequence[tuple[str, str, Mapping[str, str], Sequence[str]]],
    *,
    salt: str = "",
) -> list[Cell]:
    """Return a cell for each place and policy. ``policies``: label, reference, arguments, variables of each."""
    labels = [label for label, *_ in policies]
    if twice := next((label for label in labels if labels.count(label) > 1), None):
        raise ConfigError(f"{twice!r} is there twice; give each a label of its own")
    cells: list[Cell] = []
    for place in places:
        planned = {"protocol": place.protocol, "tasks": place.tasks, "seeds": place.seeds}
        for number, (label, text, arguments, environment) in enumerate(policies):
            specs = plan_trials(policy=text, arguments=arguments, environment=environment, **planned)
            cells.append(Cell(policy=number, label=label, place=place, specs=tuple(with_salt(specs, salt))))
    return cells


def with_noise(cells: Sequence[Cell], salt: str) -> list[Cell]:
    """Return the cells with one salt of the sensor noise in all those whose protocol has any."""
    if not any(cell.place.protocol.variation.sensor_noise for cell in cells):
        raise ConfigError("--noise-salt: no protocol of this plan has sensor noise; leave the option out")
    return [
        replace(cell, specs=tuple(with_noise_salt(list(cell.specs), salt, one_of_several=False)))
        if cell.place.protocol.variation.sensor_noise
        else cell
        for cell in cells
    ]


def _along(protocol: Protocol, axis: str, value: Value) -> Protocol:
    if axis == "friction":
        if isinstance(value, str) and value not in SKIN_STATES:
            raise ConfigError(f"expected a coefficient, or {', '.join(SKIN_STATES)}, got {value!r}")
        coefficient = SKIN_STATES[value].coefficient if isinstance(value, str) else value
        changes: dict[str, Value] = {f"person.tissue.{name}.friction": coefficient for name in protocol.soft_regions}
    elif axis == "latency_ms":
        if isinstance(value, str):
            raise ConfigError(f"expected a number of milliseconds, got {value!r}")
        changes = {AXES[axis]: value / 1000}
    elif axis in AXES or "." in axis:
        changes = {AXES.get(axis, axis): value}
    else:
        valid = ["protocol", "level", *AXES]
        raise ConfigError(
            f"no such axis{did_you_mean(axis, valid)}; valid: {', '.join(valid)}, and any field of the "
            'protocol by its dotted name, such as "gates.touch.duration_s"'
        )
    return overridden(protocol, changes)


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value)
    return Path(text).stem if text.endswith((".toml", ".npz")) else text
