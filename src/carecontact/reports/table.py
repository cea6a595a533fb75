"""The per-task summary of one run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carecontact.reports.text import NOT_DEFINED, shown, task_name
from carecontact.runs.pooling import check_one_run, judged
from carecontact.scoring.metrics.metric import METRICS, Metric, metrics_in_order
from carecontact.scoring.result import TrialScore
from carecontact.stats import Median, median

POOLED = "all"
COUNTS = ("task", "name", "n", "success", "region-correct", "safety-gated")


def headlines() -> list[Metric]:
    """Return the metrics that have a column of their own."""
    return [row for row in metrics_in_order() if row.headline and row.median]


def columns() -> tuple[str, ...]:
    """Return heads of the columns of ``SummaryRow.cells``."""
    return (*COUNTS, *(row.label for row in headlines()))


@dataclass(frozen=True, kw_only=True)
class SummaryRow:
    """Counts and medians of one task, or of all trials (``task_id`` is POOLED)."""

    task_id: str
    name: str
    n: int
    success: int
    region_correct: int
    safety_gated: int
    medians: dict[str, Median]
    """Id of a headline metric -> its median over the trials that it is pooled over."""

    def cells(self) -> list[str]:
        """Return strings under ``columns``; a median carries its valid n where that is not the row's n."""
        rates = [f"{k}/{self.n}" for k in (self.success, self.region_correct, self.safety_gated)]
        return [self.task_id, self.name, str(self.n), *rates, *self.median_cells()]

    def median_cells(self) -> list[str]:
        return [self._cell(METRICS[id_]) for id_ in self.medians]

    def _cell(self, metric: Metric) -> str:
        found = self.medians[metric.id]
        if metric.actions is not None and not found.n:
            return NOT_DEFINED
        valid = "" if found.estimate is None or found.n_valid == self.n else f" (n={found.n_valid})"
        return shown(found.estimate, digits=metric.digits, unit=metric.unit) + valid


def sorted_scores(scores: Iterable[TrialScore]) -> list[TrialScore]:
    return sorted(scores, key=lambda s: (s.task_id, s.seed, s.trial_id))


def summary_rows(scores: Sequence[TrialScore]) -> list[SummaryRow]:
    """Return one row per task in task order, then one over all trials; empty without scores.

    Trials in which the harness failed are in no count; a task that has no other keeps its row, with n = 0.
    Raises ConfigError if the scores mix protocols, policies or worlds.
    """
    check_one_run(scores)
    if not scores:
        return []
    ordered = sorted_scores(scores)
    tasks: dict[str, list[TrialScore]] = {}
    for score in ordered:
        tasks.setdefault(score.task_id, []).append(score)
    rows = [_row(task_id, task_name(group[0]), group) for task_id, group in tasks.items()]
    return [*rows, _row(POOLED, "All trials", ordered)]


def _row(task_id: str, name: str, group: Sequence[TrialScore]) -> SummaryRow:
    group = judged(group)
    return SummaryRow(
        task_id=task_id,
        name=name,
        n=len(group),
        success=sum(s.c3_success for s in group),
        region_correct=sum(s.region_correct for s in group),
        safety_gated=sum(s.safety_gated for s in group),
        medians={row.id: median(row.pooled(group)) for row in headlines()},
    )
