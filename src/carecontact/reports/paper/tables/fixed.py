"""The tables that depend on the protocol alone: capability, tasks, metrics and protocol."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.reports.paper.published import Paper
from carecontact.reports.paper.table import ABSENT, Table
from carecontact.scoring.metrics.metric import METRICS

CAPABILITIES = (
    "Deformable human", "Passive joints", "Force calibration", "Leak-free observation", "Physics-aware scoring",
)  # fmt: skip


def capability(paper: Paper) -> Table:
    return Table(
        name="capability",
        caption="Capabilities of benchmarks, as the paper judges them",
        head=("System", *CAPABILITIES),
        rows=tuple((system, *marks) for system, marks in paper.capability.items()),
        notes=("All cells are the paper's; nothing here was measured.",),
    )


def tasks(protocol: Protocol, paper: Paper) -> Table:
    rows = ((task.id, task.name, task.prompt, *paper.tasks.get(task.id, [ABSENT, ABSENT])) for task in protocol.tasks)
    return Table(
        name="tasks",
        caption=f"Tasks of {protocol.title}",
        head=("ID", "Task", "Prompt", "Paper: task", "Paper: purpose"),
        rows=tuple(rows),
    )


def metrics(paper: Paper) -> Table:
    rows: list[tuple[str, ...]] = []
    for id_, metric in METRICS.items():
        if metric.name in paper.metrics:
            direction = {"higher": "higher", "lower": "lower", "neither": ABSENT}[metric.better]
            unit = ABSENT if metric.unit == "1" else metric.unit
            rows.append((metric.name, metric.title, unit, direction, id_, *paper.metrics[metric.name]))
    return Table(
        name="metrics",
        caption="Scores",
        head=("Score", "What it is", "Unit", "Better", "Definition", "Paper: layer", "Paper: score"),
        rows=tuple(rows),
        notes=("docs/scoring.md defines each.",),
    )


def protocol_table(protocol: Protocol, paper: Paper) -> Table:
    low, high = protocol.randomization.comfort_arm_deg
    seeds, limits = len(protocol.randomization.seeds), protocol.limits
    ours = {
        "Comfort-arm angle": f"{low:g} to {high:g} deg",
        "Initialisations": f"{seeds} a task",
        "Tasks": f"{len(protocol.tasks)}",
        "Runs a method": f"{seeds * len(protocol.tasks)}",
        **{f"Pain onset, {name.replace('_', ' ')}": f"{value:g} N" for name, value in limits.f_pain_n.items()},
        "Safety gate": f"{limits.gamma:g} of the pain onset",
        "Without valid contact": "C1, C2 and C5 are NA, C3 is 0",
        "Time limit": f"{protocol.phases.time_limit_s:g} s",
        "Physics step": f"{1000 * protocol.physics.dt_s:g} ms",
        "Person": protocol.person.body,
        "Tissue": protocol.person.tissue_set,
        "Hash of the protocol": protocol.sha256[:12],
    }
    return Table(
        name="protocol",
        caption=f"Protocol {protocol.title}",
        head=("Item", "Ours", "Paper"),
        rows=tuple((item, text, paper.protocol.get(item, ABSENT)) for item, text in ours.items()),
    )
