"""How much a trial's verdict hangs on numbers that had to be chosen: the gates moved one at a time."""

from __future__ import annotations

from dataclasses import replace

from carecontact.contract.protocol import Gates
from carecontact.scoring.contact import Contact, with_floor
from carecontact.scoring.metrics.c3_success import Measures, judge, measure
from carecontact.scoring.verdict import Verdict, reach_verdict

SWEEPS: dict[str, tuple[float, ...]] = {
    "floor_n": (0.25, 0.5, 1.0, 2.0),
    "push_force_n": (1.0, 3.0, 5.0),
    "push_wrist_m": (0.010, 0.020, 0.030),
    "scrub_stroke_m": (0.100, 0.200),
    "scrub_extent_m": (0.030, 0.050, 0.060),
}
"""Gate -> values; each sweep leaves the other gates at the protocol's, the floor its ratio of off to on."""


def level(verdict: Verdict) -> int:
    """How far through the funnel: 0 failed, 1 success, 2 region-correct too, 3 safety-gated too."""
    return int(verdict.success) + int(verdict.region_correct) + int(verdict.safety_gated)


def sweep_gates(contact: Contact, measures: Measures, verdict: Verdict) -> dict[str, dict[str, int]]:
    """Sweep -> value of the gate -> ``level`` there.

    Args:
        measures: of the contact as the protocol has it.
        verdict: at the protocol's own gates.
    """
    own = level(verdict)
    out: dict[str, dict[str, int]] = {}
    for name, values in SWEEPS.items():
        applies = name == "floor_n" or name.startswith(contact.task.action)
        out[name] = {f"{v:g}": _level_at(contact, measures, name, v) if applies else own for v in values}
    return out


def _level_at(contact: Contact, measures: Measures, name: str, value: float) -> int:
    if name == "floor_n":
        definition = contact.protocol.contact
        off_n = value * definition.off_n / definition.on_n
        if (value, off_n) != (definition.on_n, definition.off_n):
            contact = with_floor(contact, on_n=value, off_n=off_n)
            action = contact.task.action
            measures = measure(contact, episodes=action == "scrub", wrist=action == "push")
        changed = contact
    else:
        gates = _changed(contact.protocol.gates, name, value)
        changed = replace(contact, protocol=contact.protocol.model_copy(update={"gates": gates}))
    return level(reach_verdict(changed, judge(changed, measures)))


def _changed(gates: Gates, name: str, value: float) -> Gates:
    match name:
        case "push_force_n":
            return gates.model_copy(update={"push": gates.push.model_copy(update={"force_n": value})})
        case "push_wrist_m":
            return gates.model_copy(update={"push": gates.push.model_copy(update={"wrist_displacement_m": value})})
        case "scrub_stroke_m":
            return gates.model_copy(update={"scrub": gates.scrub.model_copy(update={"stroke_m": value})})
        case _:
            return gates.model_copy(update={"scrub": gates.scrub.model_copy(update={"extent_m": value})})
