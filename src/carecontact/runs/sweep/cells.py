"""The cells of a plan: one run for each policy and each combination of the axes' values."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError, did_you_mean
from carecontact.protocols import load_levels, load_protocol, overridden
from carecontact.protocols.friction import SKIN_STATES
from carecontact.runs.freeze import check_frozen
from carecontact.runs.plan import parse_seeds, parse_tasks, plan_trials, with_noise_salt
from carecontact.runs.preflight import check_protocol, check_rows
from carecontact.runs.salt import with_salt
from carecontact.runs.sweep.factors import AXIS, factor_protocols
from carecontact.runs.sweep.plan import AXES, Plan, Value

CELLS = "cells"
"""Folder of a sweep, below which every cell has its own."""
NAME_CHARACTERS = 100
DIGEST_CHARACTERS = 8
NAME_LEVELS = 'name levels in axes.level, or each beside its protocol, such as "bathing-wide-v2-draft L0"'


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
    policy: int
    """The policy's number in the plan."""
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
        told = [re.sub(r"[^A-Za-z0-9.-]+", "-", text) for text in (self.label, *self.place.values.values())]
        return f"{'_'.join(told).strip('-.')[:NAME_CHARACTERS]}_{digest}"


def places_of(plan: Plan, *, named: str) -> list[Place]:
    """Return every combination, in the order of the plan's axes.

    Args:
        named: how messages name the plan.

    Raises ConfigError naming the axis, the value and what is valid.
    """
    axes = [name for name in plan.axes if name not in ("protocol", "level")]
    places: list[Place] = []
    for shown, whole in _bases(plan, named):
        rules = _changed(whole, plan.set, place=f"plan {named}: set")
        for axis in axes:
            for value in plan.axes[axis]:
                _checked(_along(rules, axis, value, place=f"plan {named}: axes.{axis}"), place=f"{named}: axes.{axis}")
        tasks, seeds = _trials(plan, rules, named)
        for values in product(*(plan.axes[axis] for axis in axes)):
            chosen = dict(zip(axes, values, strict=True))
            made = rules
            # The tissue first: its rows have frictions of their own.
            for axis, value in sorted(chosen.items(), key=lambda pair: pair[0] != "tissue"):
                made = _along(made, axis, value, place=f"plan {named}: {_told(chosen)}")
            texts = shown | {axis: _text(value) for axis, value in chosen.items()}
            places.append(Place(values=texts, protocol=made, tasks=tasks, seeds=seeds))
    return places


def _bases(plan: Plan, named: str) -> list[tuple[dict[str, str], Protocol]]:
    """Return what the other axes are varied on, with the value of its own axis where it has one."""
    if plan.factors is not None:
        place = f"plan {named}: factors"
        low, high = (_loaded(name, place) for name in (plan.factors.low, plan.factors.high))
        groups = {name: [str(path) for path in paths] for name, paths in plan.factors.groups.items()}
        found = factor_protocols(low, high, groups, place=place)
        return [({AXIS: value}, protocol) for value, protocol in found.items()]
    found = []
    for name, level in product(plan.protocols, plan.levels):
        shown = {"protocol": name} if "protocol" in plan.axes else {}
        if level is not None:
            shown["level"] = level
        place = f"plan {named}: axes.{'protocol' if level is None else 'level'}"
        found.append((shown, _loaded(name, place, level=level)))
    return found


def _loaded(name: str, place: str, *, level: str | None = None) -> Protocol:
    """Return a protocol as titles name it: its id or file, and its level after a space where it has levels."""
    whole, _, titled = name.partition(" ") if not name.endswith(".toml") else (name, "", "")
    wanted = level or titled or None
    try:
        levels = ", ".join(filter(None, load_levels(whole)))
        if bool(levels) != bool(wanted):
            told = f"has the levels {levels}" if levels else f"has no levels, and so no {wanted}"
            raise ConfigError(f"{whole} {told}; {NAME_LEVELS}")
        return check_frozen(whole, load_protocol(whole, level=wanted), unfrozen=False)
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from None


def cells_of(
    plan: Plan,
    places: Sequence[Place],
    policies: Sequence[tuple[str, str, Mapping[str, str], Sequence[str]]],
    *,
    salt: str = "",
) -> list[Cell]:
    """Return one cell for each place and policy, place by place.

    Args:
        policies: label, text of the reference, arguments and names of variables of each policy of the plan.
        salt: the secret of a salted run.
    """
    labels = [label for label, *_ in policies]
    if twice := next((label for label in labels if labels.count(label) > 1), None):
        raise ConfigError(f"{twice!r} is there twice; give each a label of its own")
    return [
        Cell(
            policy=number,
            label=label,
            place=place,
            specs=tuple(
                with_salt(
                    plan_trials(
                        protocol=place.protocol, policy=text, tasks=place.tasks, seeds=place.seeds,
                        arguments=arguments, environment=environment,
                    ),
                    salt,
                )
            ),
        )
        for place in places
        for number, (label, text, arguments, environment) in enumerate(policies)
    ]  # fmt: skip


def with_noise(cells: Sequence[Cell], salt: str) -> list[Cell]:
    """Return the cells with one salt of the sensor noise in all those whose protocol has any.

    Raises ConfigError where none has, and as ``with_noise_salt``.
    """
    if not any(cell.place.protocol.variation.sensor_noise for cell in cells):
        raise ConfigError("--noise-salt: no protocol of this plan has sensor noise; leave the option out")
    return [
        replace(cell, specs=tuple(with_noise_salt(list(cell.specs), salt, one_of_several=False)))
        if cell.place.protocol.variation.sensor_noise
        else cell
        for cell in cells
    ]


def _along(protocol: Protocol, axis: str, value: Value, *, place: str) -> Protocol:
    """Return the protocol with one value of an axis."""
    if axis == "friction":
        if isinstance(value, str) and value not in SKIN_STATES:
            raise ConfigError(f"{place}: expected a coefficient, or {', '.join(SKIN_STATES)}, got {value!r}")
        coefficient = SKIN_STATES[value].coefficient if isinstance(value, str) else value
        changes: dict[str, Value] = {f"person.tissue.{name}.friction": coefficient for name in protocol.soft_regions}
    elif axis == "latency_ms":
        if isinstance(value, str):
            raise ConfigError(f"{place}: expected a number of milliseconds, got {value!r}")
        changes = {AXES[axis]: value / 1000}
    elif axis in AXES or "." in axis:
        changes = {AXES.get(axis, axis): value}
    else:
        valid = ["protocol", "level", *AXES]
        raise ConfigError(
            f"{place}: no such axis{did_you_mean(axis, valid)}; valid: {', '.join(valid)}, and any field of the "
            'protocol by its dotted name, such as "gates.touch.duration_s"'
        )
    return _changed(protocol, changes, place=place)


def _changed(protocol: Protocol, changes: Mapping[str, Value], *, place: str) -> Protocol:
    try:
        return overridden(protocol, changes)
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from None


def _checked(protocol: Protocol, *, place: str) -> None:
    try:
        check_protocol(protocol)
        check_rows(protocol)
    except ConfigError as error:
        raise ConfigError(f"plan {place}: {error}") from None


def _trials(plan: Plan, protocol: Protocol, named: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
    parsers = (partial(parse_tasks, plan.tasks, protocol=protocol), partial(parse_seeds, plan.seeds, protocol=protocol))
    try:
        tasks, seeds = (parse() for parse in parsers)
    except ConfigError as error:
        raise ConfigError(f"plan {named}: {error}") from None
    return tuple(map(str, tasks)), tuple(map(int, seeds))


def _told(chosen: Mapping[str, Value]) -> str:
    return ", ".join(f"{axis} = {_text(value)}" for axis, value in chosen.items())


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value)
    return Path(text).stem if text.endswith((".toml", ".npz")) else text
