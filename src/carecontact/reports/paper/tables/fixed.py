"""The tables of what was asked and how it is scored: capability, tasks and metrics."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.contract.protocol import Protocol
from carecontact.reports.paper.method import Method
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


def tasks(protocol: Protocol, paper: Paper, methods: Sequence[Method]) -> Table:
    """``methods``: they tell which of the protocol's tasks ran."""
    ran = {score.task_id for method in methods for score in method.scores}
    rows = (
        (
            task.id,
            task.name if task.id in ran else f"{task.name} (not run)",
            task.prompt,
            *paper.tasks.get(task.id, [ABSENT, ABSENT]),
        )
        for task in protocol.tasks
    )
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
