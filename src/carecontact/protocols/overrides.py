"""Replace fields of a loaded protocol by their dotted paths, record the replacements in it, and undo them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, cast

from pydantic import BaseModel, ValidationError

from carecontact.contract.protocol import Protocol, Vision
from carecontact.errors import ConfigError, did_you_mean
from carecontact.protocols.tissue_sets import load_tissue_set
from carecontact.protocols.wrong_fields import faults

BODIES = "variation.bodies"
"""If the user chooses a body, the seed draws none."""
FAST_DT_S = 0.004
"""The fast mode's physics step; ``carecontact validate`` shows what it does to the scores."""
FOLLOWS = {
    "person.tissue": "person.tissue_set", "vision.weights_sha256": "vision.segmenter", BODIES: "person.body"
}  # fmt: skip
"""Path -> the path together with which it is replaced, recorded and restored."""
NOT_REPLACEABLE = ("id", "description", "frozen", "level", "levels", "overrides")
"""Fields that identify a protocol. The id stays, because the seeds' random numbers come from it, so that trials are
paired over what is replaced."""


def overridden(protocol: Protocol, changes: Mapping[str, object]) -> Protocol:
    """Return a copy with these fields replaced and ``overrides`` saying so: another sha256, the same id.

    A field that has the wanted value already is not an override.

    Args:
        changes: dotted path -> value. Text is converted to the field's type, as TOML is read; a task is named by its
            id (``tasks.T1.prompt``). ``person.tissue_set`` is a shipped set or a TOML file, or several of them, and its
            rows come with it.

    Raises UnknownNameError for a tissue set, ConfigError for a path that does not exist, which names the valid ones at
    that level, and for a value that does not fit.
    """
    content = cast("dict[str, Any]", _plain(protocol))
    wanted = _with_rows(protocol, changes)
    # What brings others along goes first, and tables before their fields: then the more exact one stays.
    changed: list[str] = []
    for path in sorted(wanted, key=lambda p: (p not in FOLLOWS.values(), p.count("."))):
        parts = path.split(".")
        now = _at(content, parts, path)
        value = _converted(wanted[path], now)
        if value != now:
            changed.append(path)
            content = _with(content, parts, value)
    try:
        made = Protocol.model_validate(content)
    except ValidationError as error:
        given = ", ".join(f"{path}={value!s:.40}" for path, value in changes.items())
        raise ConfigError(
            f"{protocol.id} with {given}: {'; '.join(faults(error, model=Protocol, content=content))}"
        ) from None
    said = dict(protocol.overrides)
    for path in changed:
        leader = path if path == BODIES and BODIES in changes else FOLLOWS.get(path, path)
        said = {old: value for old, value in said.items() if not old.startswith(f"{path}.")}
        said[leader] = _spelled(made, leader)
    return made.model_copy(update={"overrides": said})


def without_overrides(protocol: Protocol, original: Protocol) -> Protocol:
    """Return a copy whose replaced fields are ``original``'s again: equal to it unless more was changed than announced.

    A recorded path that ``original`` does not have stays as it is.
    """
    for leader in protocol.overrides:
        for path in (leader, *(path for path, other in FOLLOWS.items() if other == leader)):
            parts = path.split(".")
            try:
                protocol = _with(protocol, parts, _at(original, parts, path))
            except ConfigError:
                continue
    return protocol.model_copy(update={"overrides": {}})


def _with_rows(protocol: Protocol, changes: Mapping[str, object]) -> dict[str, object]:
    """Return the changes with what follows from them: no body is drawn where one is chosen, and the rows of the tissue
    set that they name, one for each soft region of the protocol."""
    if "person.body" in changes and BODIES not in changes:
        changes = {**changes, BODIES: []}
    name = changes.get("person.tissue_set")
    if name is None or "person.tissue" in changes:
        return dict(changes)
    names = [str(one) for one in name] if isinstance(name, list | tuple) else [str(name)]
    chosen = load_tissue_set(*names)
    missing = [region for region in protocol.soft_regions if region not in chosen.tissue]
    if missing:
        raise ConfigError(
            f"tissue set {' and '.join(names)}: no row for {', '.join(missing)}, which {protocol.id} needs"
        )
    rows = {region: chosen.tissue[region] for region in protocol.soft_regions}
    return {**changes, "person.tissue_set": chosen.id, "person.tissue": _plain(rows)}


def _converted(value: object, now: object) -> object:
    """Text as the value that TOML would read, where the field is not itself text."""
    if not isinstance(value, str) or isinstance(now, str):
        return _plain(value)
    try:
        return tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return value  # the schema says what it expected


def _spelled(protocol: Protocol, path: str) -> str:
    """Return the new value as titles and recordings show it."""
    if path == "vision.segmenter":
        vision: Vision = protocol.vision
        return f"{vision.segmenter} {vision.weights_sha256[:12]}".strip()
    value = _plain(_at(protocol, path.split("."), path))
    if isinstance(value, float):
        return f"{value:g}"
    return value if isinstance(value, str) else json.dumps(value)


def _plain(node: object) -> object:
    """Models as tables, defaults included; JSON-like otherwise."""
    if isinstance(node, BaseModel | Mapping):
        return {name: _plain(child) for name, child in _children(node).items()}
    return [_plain(child) for child in node] if isinstance(node, list | tuple) else node


def _children(node: object) -> dict[str, Any]:
    """Return what a step of a path can name: fields of a model, keys of a table, ids of a list of tables."""
    if isinstance(node, BaseModel):
        names = (*type(node).model_fields, *(node.model_extra or ()))
        return {name: getattr(node, name) for name in names}
    if isinstance(node, Mapping):
        return dict(node)
    if isinstance(node, list):
        return {child["id"]: child for child in map(_children, node) if "id" in child}
    return {}


def _at(node: object, parts: Sequence[str], path: str) -> object:
    """Return the value at a path. Raises ConfigError naming what is valid where it ends."""
    for depth, name in enumerate(parts):
        children = {k: v for k, v in _children(node).items() if depth or k not in NOT_REPLACEABLE}
        if name not in children:
            place = ".".join(parts[:depth]) or "a protocol"
            valid = ", ".join(children) or f"none, {place} is a single value"
            raise ConfigError(f"{path}: no field {name!r} in {place}{did_you_mean(name, children)}; valid: {valid}")
        node = children[name]
    return node


def _with(node: Any, parts: Sequence[str], value: object) -> Any:
    """Return a copy of a model, table or list with the value at a path that ``_at`` has found; nothing is validated."""
    if not parts:
        return value
    name, rest = parts[0], parts[1:]
    if isinstance(node, list):
        return [_with(child, rest, value) if _children(child).get("id") == name else child for child in node]
    child = _with(_children(node)[name], rest, value)
    if isinstance(node, BaseModel):
        return node.model_copy(update={name: child})
    return {**node, name: child}
