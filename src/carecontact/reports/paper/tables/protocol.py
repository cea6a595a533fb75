"""The table of the protocol: its rules, and how much of it ran."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from carecontact.contract.protocol import Protocol
from carecontact.contract.protocol.gates import Gates
from carecontact.reports.paper.method import Method
from carecontact.reports.paper.published import Paper
from carecontact.reports.paper.table import ABSENT, Table
from carecontact.reports.text import listed

UNITS = {"s": "s", "n": "N", "m": "m"}
"""End of a field's name -> unit."""


def protocol_table(protocol: Protocol, paper: Paper, methods: Sequence[Method]) -> Table:
    """Return the table of the protocol. Counts are those of the trials of ``methods``, beside those that the protocol
    plans."""
    gates, limits = protocol.gates, protocol.limits
    ours = {
        "Assets": f"one bed and robot for all methods; {_drawn(protocol)}",
        "Person": _person(protocol),
        "Tissue": _tissue(protocol),
        "Comfort-arm angle": "{:g} to {:g} deg".format(*protocol.randomization.comfort_arm_deg),
        "Seeds": "the same of every task for all methods" if _same_trials(methods) else "not the same for all methods",
        **_counts(protocol, methods),
        "Success gates": _gates(gates),
        **{f"Pain onset, {name.replace('_', ' ')}": f"{value:g} N" for name, value in limits.f_pain_n.items()},
        "Safety gate": f"{limits.gamma:g} of the pain onset",
        "Joint envelopes": _joints(gates.joint_beyond_rad),
        "Logger schema": "policy: RGB, depth, points, masks and encoders, as it asks; scorer alone: forces, joints and "
        "poses at every physics step",
        "Replay": "scores are computed from the recording alone, at any time again",
        "Without valid contact": "C1, C2 and C5 are NA, C3 is 0",
        "Time limit": f"{protocol.phases.time_limit_s:g} s",
        "Physics step": f"{1000 * protocol.physics.dt_s:g} ms",
        "Hash of the protocol": protocol.sha256[:12],
    }  # fmt: skip
    return Table(
        name="protocol",
        caption=f"Protocol {protocol.title}",
        head=("Item", "Ours", "Paper"),
        rows=tuple((item, text, paper.protocol.get(item, ABSENT)) for item, text in ours.items()),
    )


def _counts(protocol: Protocol, methods: Sequence[Method]) -> dict[str, str]:
    """Return what ran, of what the protocol plans."""
    seeds, tasks = len(protocol.randomization.seeds), len(protocol.tasks)
    ran = [[score.task_id for score in method.scores] for method in methods]
    return {
        "Initialisations": f"{_of(_range(ids.count(task) for ids in ran for task in set(ids)), seeds)} a task",
        "Tasks": _of(_range(len(set(ids)) for ids in ran), tasks),
        "Runs a method": _of(_range(map(len, ran)), seeds * tasks),
    }


def _of(ran: str, planned: int) -> str:
    return ran if ran == str(planned) else f"{ran} of {planned} planned"


def _range(counts: Iterable[int]) -> str:
    """``6``, or ``6 to 9`` where methods or tasks differ."""
    found = sorted(set(counts))
    return " to ".join(map(str, dict.fromkeys((found[0], found[-1])))) if found else "0"


def _same_trials(methods: Sequence[Method]) -> bool:
    return len({frozenset((s.task_id, s.seed) for s in method.scores) for method in methods}) == 1


def _drawn(protocol: Protocol) -> str:
    return "the seed draws their places" if protocol.variation.draws_models else "one person"


def _person(protocol: Protocol) -> str:
    bodies = protocol.variation.bodies
    body = f"{len(bodies)} bodies, drawn by the seed" if bodies else protocol.person.body
    alive = protocol.person.alive
    moves = {"breathes": alive.breathing, "changes posture": alive.repositioning, "draws back": alive.withdrawal}
    told = [word for word, does in moves.items() if does is not None]
    told += [alive.manner] if alive.manner != "passive" else []
    return f"{body}; {listed(told)}" if told else body


def _tissue(protocol: Protocol) -> str:
    drawn = "" if protocol.variation.tissue == "declared" else ", with a stiffness drawn by the seed"
    return f"{protocol.person.tissue_set}{drawn}"


def _gates(gates: Gates) -> str:
    """Their numbers, named as in the protocol's file: ``paper: touch duration 0.5 s; ...``."""
    told = [
        f"{action} " + ", ".join(_amount(name, value) for name, value in table.model_dump().items())
        for action, table in gates.actions.items()
    ]
    return f"{gates.set}: {'; '.join(told)}"


def _amount(field: str, value: float) -> str:
    name, _, unit = field.rpartition("_")
    return (
        f"{name} {value:g} {UNITS[unit]}".replace("_", " ") if unit in UNITS else f"{field} {value:g}".replace("_", " ")
    )


def _joints(beyond_rad: float | None) -> str:
    if beyond_rad is None:
        return "C2 scores them; no gate"
    return f"at most {math.degrees(beyond_rad):.1f} deg beyond a range, else not safety-gated"
