"""How a trial's result depends on each value that the benchmark chose, changed alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from carecontact.errors import ConfigError
from carecontact.protocol.protocol import Protocol
from carecontact.scoring.behaviour import BEHAVIOURS, Sweep, behaviour_of
from carecontact.scoring.contact import Contact, with_floor
from carecontact.scoring.metrics.success import Measures, judge, measure
from carecontact.scoring.verdict import Verdict, reach_verdict

FLOOR = Sweep(name="floor_n", field="on_n", values=(0.25, 0.5, 1.0, 2.0), title="Contact floor", unit="N")
"""The sweep of the force at which contact begins (``ContactDefinition``), for every action; the force at which contact
ends keeps its ratio to it."""


def protocol_sweeps(protocol: Protocol) -> dict[str, tuple[str | None, Sweep]]:
    """Name -> action (None: all) and sweep, of a protocol. Raises ConfigError where two have one name."""
    used = {task.action for task in protocol.tasks}
    return sweeps_of((action for action in protocol.gates.actions if action in used), protocol.gates.set)


def sweeps_of(actions: Iterable[str], gates: str) -> dict[str, tuple[str | None, Sweep]]:
    """Return what ``protocol_sweeps`` returns, for these actions under a set of gates, and raise as it does."""
    found: dict[str, tuple[str | None, Sweep]] = {FLOOR.name: (None, FLOOR)}
    for action in actions:
        for sweep in behaviour_of(action, gates).sweeps:
            if sweep.name in found:
                other = found[sweep.name][0]
                owner = "the contact floor" if other is None else BEHAVIOURS.title(other)
                raise ConfigError(
                    f"{owner} and {BEHAVIOURS.title(action)} both have a sweep named {sweep.name!r}; "
                    "begin the name of a sweep with its action"
                )
            found[sweep.name] = action, sweep
    return found


def own_value(protocol: Protocol, action: str | None, sweep: Sweep) -> float:
    """Return the protocol's own value of a swept field."""
    return float(getattr(protocol.contact if action is None else protocol.gates.of(action), sweep.field))


def level(verdict: Verdict) -> int:
    """0: failed, 1: success, 2: also region-correct, 3: also safety-gated."""
    return int(verdict.success) + int(verdict.region_correct) + int(verdict.safety_gated)


def sweep_gates(contact: Contact, measures: Measures, verdict: Verdict) -> dict[str, dict[str, int]]:
    """Sweep -> value of the gate -> ``level`` there; the other gates, measures and verdict are the protocol's own."""
    own = level(verdict)
    out: dict[str, dict[str, int]] = {}
    for name, (action, sweep) in protocol_sweeps(contact.protocol).items():
        if action is None:
            out[name] = {f"{v:g}": _level_at_floor(contact, measures, verdict, v) for v in sweep.values}
        elif action == contact.task.action:
            out[name] = {f"{v:g}": _level_at(contact, measures, verdict, sweep.field, v) for v in sweep.values}
        else:
            out[name] = {f"{v:g}": own for v in sweep.values}
    return out


def _level_at_floor(contact: Contact, measures: Measures, own: Verdict, on_n: float) -> int:
    definition = contact.protocol.contact
    off_n = on_n * definition.off_n / definition.on_n
    if (on_n, off_n) != (definition.on_n, definition.off_n):
        contact = with_floor(contact, on_n=on_n, off_n=off_n)
        measures = measure(contact, needed=True)
    return level(reach_verdict(contact, judge(contact, measures), own=own))


def _level_at(contact: Contact, measures: Measures, own: Verdict, field: str, value: float) -> int:
    action, gates = contact.task.action, contact.protocol.gates
    gate = gates.of(action).model_copy(update={field: value})
    protocol = contact.protocol.model_copy(update={"gates": gates.model_copy(update={action: gate})})
    changed = replace(contact, protocol=protocol)
    return level(reach_verdict(changed, judge(changed, measures), own=own))
