"""``carecontact list``: the names that the command line accepts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Annotated, Any, Literal

import tyro

from carecontact.cli.groups import JsonGroup, ProtocolGroup
from carecontact.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class List:
    """List names: those that the command line accepts, and those that a protocol or a region of your own may use."""

    what: Annotated[
        Literal[
            "tasks", "actions", "regions", "segments", "spaces", "deltas", "controls", "robots", "policies",
            "protocols", "bodies", "tissue", "metrics", "limits", "all",
        ],
        tyro.conf.Positional,
    ] = "all"  # fmt: skip
    """Kind of names to list."""
    rules: ProtocolGroup = field(default_factory=ProtocolGroup)
    output: JsonGroup = field(default_factory=JsonGroup)

    def __call__(self) -> int:
        kinds = list(KINDS) if self.what == "all" else [self.what]
        if self.output.json:
            from carecontact.cli.answers import ListAnswer, Name
            from carecontact.cli.console import print_answer

            rows = {kind: KINDS[kind](self.rules.protocol) for kind in kinds}
            names = {kind: [Name(name=name, meaning=meaning) for name, meaning in rows[kind]] for kind in kinds}
            print_answer(ListAnswer(names=names))
            return 0
        indent = "  " if self.what == "all" else ""
        for kind in kinds:
            if self.what == "all":
                print(f"{kind}:")
            rows = KINDS[kind](self.rules.protocol)
            width = max((24, *(len(name) for name, _ in rows)))
            for name, meaning in rows:
                print(f"{indent}{name:{width}} {meaning}".rstrip())
        return 0


Rows = list[tuple[str, str]]
"""Names with what they mean."""
Kind = Callable[[str], Rows]
"""Id or file of a protocol -> the names of one kind."""


def registered(registry: str, meaning: Callable[[Any], str]) -> Kind:
    """Return the kind that lists a registry, ``module:NAME``; of a name that cannot be loaded, the reason."""

    def rows(protocol: str) -> Rows:
        module, _, name = registry.partition(":")
        table = getattr(import_module(f"carecontact.{module}"), name)
        found: Rows = []
        for each in table:
            try:
                found.append((each, meaning(table[each])))
            except ConfigError as error:
                found.append((each, str(error)))
        return found

    return rows


def _tasks(protocol: str) -> Rows:
    from carecontact.protocol.load import load_levels

    rules = next(iter(load_levels(protocol).values()))
    return [(task.id, f"{task.name}: {task.prompt!r}") for task in rules.tasks]


def _actions(protocol: str) -> Rows:
    from carecontact.protocol.load import load_protocol

    gates = load_protocol(protocol).gates.set
    fields = registered(
        "protocol.gates:ACTIONS", lambda row: f"gate: {', '.join(row.gate_in(gates).model_fields) or 'no fields'}"
    )
    return fields(protocol)


def _regions(protocol: str) -> Rows:
    from carecontact.interface.regions import all_regions

    listed = registered(
        "interface.regions:REGIONS",
        lambda row: f"{'soft' if row.soft else 'rigid'}, on {row.segment.replace('_', ' ')}",
    )
    found = dict(listed(protocol))
    return [(name, found[name]) for name in all_regions()]


def _segments(protocol: str) -> Rows:
    from carecontact.interface.regions import JOINTS, LIMB_PARTS, SEGMENTS

    rows = [(name, "Body segment: a value of `segment` and `neighbourhood` of a region.") for name in SEGMENTS]
    rows += [(name, "Limb part: a value of `closed_by` in a region's shape.") for name in LIMB_PARTS]
    return [*rows, *((name, "Joint: a value of `joints` in a region's sight.") for name in JOINTS)]


def _policies(protocol: str) -> Rows:
    listed = registered("policies.registry:POLICIES", lambda row: f"{row.description} {_arguments(row.target)}")
    yours = "Your own policy, importable from the current folder. Arguments: those of its constructor."
    return [*listed(protocol), ("module:Class", yours)]


def _arguments(target: str) -> str:
    from carecontact.serving.arguments import load_factory, parameters_of

    try:
        parameters = parameters_of(load_factory(target))
    except Exception as error:
        # Another package's policy, which may raise anything, must not hide the others.
        return f"Arguments: unknown, {target} cannot be imported: {type(error).__name__}: {error}"
    return f"Arguments: {', '.join(map(str, parameters)) or 'none'}."


def _protocols(protocol: str) -> Rows:
    from carecontact.protocol.load import load_levels, shipped_protocols

    loaded = [rules for name in shipped_protocols() for rules in load_levels(name).values()]
    return [(p.name, f"{'frozen' if p.frozen else 'draft'}: {p.description} sha256 {p.sha256[:12]}") for p in loaded]


def _bodies(protocol: str) -> Rows:
    from carecontact.human.library import body_names, load_body

    sexes = {"F": "woman", "M": "man"}
    rows = [
        (
            body.name,
            f"{sexes[body.sex]:5}  {body.age_group:5}  {body.stature_m:.2f} m  {body.mass_kg:5.1f} kg  "
            f"BMI {body.bmi:.1f}  {body.licence}",
        )
        for body in map(load_body, body_names())
    ]
    return [*rows, ("smplx:FILE.npz?sex=F", "Your own SMPL-X model; see docs/person.md.")]


def _tissue(protocol: str) -> Rows:
    from carecontact.protocol.overrides import load_tissue_set, shipped_tissue_sets

    loaded = {name: load_tissue_set(name) for name in shipped_tissue_sets()}
    rows = [(name, f"{s.description} sha256 {s.sha256[:12]}") for name, s in loaded.items()]
    return [*rows, ("FILE.toml", "Your own tissue, as carecontact calibrate writes it; see docs/person.md.")]


def _metric(row: Any) -> str:
    better = "neither higher nor lower" if row.better == "neither" else row.better
    return f"{row.title}{'' if row.unit == '1' else f' [{row.unit}]'}, {better} is better"


KINDS: dict[str, Kind] = {
    "tasks": _tasks,
    "actions": _actions,
    "regions": _regions,
    "segments": _segments,
    "spaces": registered(
        "interface.action:ACTION_SPACES", lambda row: f"{row.description} Fields: {', '.join(row.fields)}."
    ),
    "deltas": registered("interface.deltas:DELTAS", lambda row: row.description),
    "controls": registered("interface.robot:CONTROLS", lambda row: row.description),
    "robots": registered(
        "interface.robot:EMBODIMENTS",
        lambda row: f"{row.id}, {len(row.joints)} joints: `scene.tool` of a protocol, --tool.",
    ),
    "policies": _policies,
    "protocols": _protocols,
    "bodies": _bodies,
    "tissue": _tissue,
    "metrics": registered("scoring:METRICS", _metric),
    "limits": registered(
        "scoring.limits:LIMIT_PACKS", lambda row: f"Pack of limits [{row.unit}]: {row.title}, {row.status}"
    ),
}
