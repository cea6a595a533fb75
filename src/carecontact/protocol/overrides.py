"""Changes of a protocol for one run: tissue sets, friction, and single fields given as `--set`."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple, cast

from pydantic import BaseModel, ValidationError

from carecontact.errors import ConfigError, UnknownNameError, did_you_mean
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.protocol.field_errors import faults, wrong_fields
from carecontact.protocol.gates import FileStem, RegionName, Section
from carecontact.protocol.person import Tissue
from carecontact.protocol.protocol import Protocol


class TissueSet(Section):
    """Tissue laws, one row for each soft region, in a TOML file of their own; a protocol names a set."""

    id: FileStem
    description: str
    base: str | None = None
    """The set from which regions without a row of their own are taken."""
    tissue: dict[RegionName, Tissue]

    @property
    def sha256(self) -> str:
        """Hash of the rows as canonical JSON: spelling, comments and name do not count."""
        rows = {region: row.model_dump(mode="json") for region, row in self.tissue.items()}
        return hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()


def shipped_tissue_sets() -> list[str]:
    folder = resources.files("carecontact.protocol") / "tissue"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def load_tissue_set(*names_or_paths: str) -> TissueSet:
    """Return a shipped set or a TOML file, with the regions that it lacks from its base. Several need one base."""
    sets = {name: _read(name) for name in names_or_paths}
    rows, owner = dict[str, Tissue](), dict[str, str]()
    for name, made in sets.items():
        for region in made.tissue:
            if owner.setdefault(region, name) != name:
                raise ConfigError(
                    f"tissue sets {owner[region]} and {name} both have a row for the {region}; give only one of them"
                )
        rows |= made.tissue
    missing = [region for region in STANDARD_REGIONS if region not in rows]
    bases = sorted({made.base for made in sets.values() if made.base is not None})
    place, valid = f"tissue set {' and '.join(sets)}", ", ".join(shipped_tissue_sets())
    if missing and len(bases) != 1:
        hint = f"add base = one of {valid}, whose rows then serve"
        if bases:
            hint = f"their bases differ ({', '.join(bases)}); give them one"
        raise ConfigError(f"{place}: no row for {', '.join(missing)}; {hint}")
    for base in bases:
        if base not in shipped_tissue_sets():
            raise ConfigError(f"{place}: base {base!r}; valid: {valid}")
    if bases:
        rows = {**load_tissue_set(bases[0]).tissue, **rows}
    return next(iter(sets.values())).model_copy(
        update={"id": "+".join(made.id for made in sets.values()), "tissue": rows}
    )


def check_accepted(protocol: Protocol, *, allowed: bool) -> None:
    """Raise ConfigError for a row that ``carecontact calibrate`` rejected, unless these are allowed."""
    rejected = protocol.person.rejected_tissue
    if rejected and not allowed:
        raise ConfigError(
            f"{protocol.title}: the calibration of its tissue was rejected: {rejected}; --allow-rejected uses it, and "
            "every report then says so"
        )


def _read(name_or_path: str) -> TissueSet:
    """Return a set with the rows of its own file."""
    shipped = name_or_path in shipped_tissue_sets()
    if shipped:
        data = (resources.files("carecontact.protocol") / "tissue" / f"{name_or_path}.toml").read_bytes()
    elif name_or_path.endswith(".toml"):
        try:
            data = Path(name_or_path).read_bytes()
        except OSError as error:
            raise ConfigError(f"tissue set {name_or_path}: {error.strerror}") from None
    else:
        raise UnknownNameError("tissue set", name_or_path, [*shipped_tissue_sets(), "FILE.toml"])
    table: dict[str, Any] = {}
    try:
        table = tomllib.loads(data.decode())
        made = TissueSet.model_validate(table)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"tissue set {name_or_path}: not TOML: {error}") from None
    except ValidationError as error:
        raise ConfigError(wrong_fields(f"tissue set {name_or_path}", error, model=TissueSet, content=table)) from None
    if not shipped and made.id in shipped_tissue_sets():
        raise ConfigError(f"tissue set {name_or_path}: the id {made.id} is a shipped set's; choose another")
    return made


# Single fields of a loaded protocol, by their dotted paths: replaced, recorded in it, and restored.

BODIES = "variation.bodies"
"""If the user chooses a body, the seed draws none."""
FAST_DT_S = 0.004
"""The fast mode's physics step; ``carecontact verify physics`` shows what it does to the scores."""
FOLLOWS = {"person.tissue": "person.tissue_set", "vision.weights_sha256": "vision.segmenter", BODIES: "person.body"}
"""Path -> the path together with which it is replaced, recorded and restored."""
NOT_REPLACEABLE = ("id", "description", "frozen", "level", "levels", "overrides")
"""Fields that identify a protocol. The id stays, because the seeds' random numbers come from it, so that trials are
paired over what is replaced."""


def overridden(protocol: Protocol, changes: Mapping[str, object]) -> Protocol:
    """Return a copy with these fields replaced, of which ``overrides`` tells: another sha256, the same id. A field that
    has the wanted value already is not an override.

    Args:
        changes: dotted path -> value. Text is converted to the field's type, as TOML is read; a task is named by its
            id (``tasks.T1.prompt``). ``person.tissue_set`` is a shipped set or a TOML file, or several of them, and its
            rows come with it.
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
    overrides = dict(protocol.overrides)
    for path in changed:
        leader = path if path == BODIES and BODIES in changes else FOLLOWS.get(path, path)
        overrides = {old: value for old, value in overrides.items() if not old.startswith(f"{path}.")}
        overrides[leader] = _spelled(made, leader)
    return made.model_copy(update={"overrides": overrides})


def without_overrides(protocol: Protocol, original: Protocol) -> Protocol:
    """Return a copy whose replaced fields are ``original``'s again, except paths that ``original`` does not have."""
    for leader in protocol.overrides:
        for path in (leader, *(path for path, other in FOLLOWS.items() if other == leader)):
            parts = path.split(".")
            try:
                protocol = _with(protocol, parts, _at(original, parts, path))
            except ConfigError:
                continue
    return protocol.model_copy(update={"overrides": {}})


def _with_rows(protocol: Protocol, changes: Mapping[str, object]) -> dict[str, object]:
    """Return the changes with what follows from them: no drawn body where one is chosen, and the tissue set's rows."""
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
        return f"{protocol.vision.segmenter} {protocol.vision.weights_sha256[:12]}".strip()
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


class SkinState(NamedTuple):
    coefficient: float
    """Of friction against the tool."""
    source: str


SKIN_STATES = {
    "dry": SkinState(
        0.5,
        "typical of dry skin, which is above 0.2: the review of Derler and Gerhardt 2012 (Tribology Letters 45:1; only "
        "its abstract was read)",
    ),
    "wet": SkinState(
        1.0, "the least of what the same review calls typical of moist or wet skin: above 1, falling with pressure"
    ),
    "soapy": SkinState(
        0.2,
        "assumed, the lower end of dry skin: soapy palms slid more easily on grab rails than dry and wet ones "
        "(Ergonomics 2001, 44:973; only its abstract was read, which gives no coefficient)",
    ),
}


def friction_changes(rules: Protocol, friction: str) -> dict[str, object]:
    """Return the fields that give all soft regions one coefficient: a name of SKIN_STATES or a number."""
    try:
        value = SKIN_STATES[friction].coefficient if friction in SKIN_STATES else float(friction)
    except ValueError:
        raise ConfigError(
            f"--friction {friction!r}: expected {', '.join(SKIN_STATES)} or a coefficient, such as 0.8"
        ) from None
    return {f"person.tissue.{region}.friction": value for region in rules.soft_regions}
