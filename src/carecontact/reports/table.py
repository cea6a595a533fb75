"""The per-task summary of one run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carecontact.reports.text import NOT_DEFINED, shown, task_name
from carecontact.runs.pooling import check_one_run, judged, task_of
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
    """Trials with a verdict."""
    unknown: int
    """Planned trials without one."""
    success: int
    region_correct: int
    safety_gated: int
    medians: dict[str, Median]
    """Id of a headline metric -> its median over the trials that it is pooled over."""

    def cells(self) -> list[str]:
        """Return strings under ``columns``; a median carries its valid n where that is not the row's n."""
        rates = [self.share(k) for k in (self.success, self.region_correct, self.safety_gated)]
        return [self.task_id, self.name, self.trials, *rates, *self.median_cells()]

    @property
    def trials(self) -> str:
        """``18``, or ``15 of 18`` where planned trials have no verdict."""
        return f"{self.n} of {self.n + self.unknown}" if self.unknown else str(self.n)

    def share(self, k: int) -> str:
        """Return a count over the planned trials: ``9/18``, or ``9–12/18`` where three have no verdict."""
        return f"{k}–{k + self.unknown}/{self.n + self.unknown}" if self.unknown else f"{k}/{self.n}"

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


def summary_rows(scores: Sequence[TrialScore], unknown: Iterable[str] | None = None) -> list[SummaryRow]:
    """Return one row per task in task order, then one over all trials; empty without scores.

    Trials without a verdict make every count an interval; a task that has no other keeps its row, with n = 0, and one
    of which nothing is scored stands in the last row alone. Raises ConfigError if the scores mix protocols, policies or
    worlds.

    Args:
        unknown: ids of the planned trials without a verdict; default: those in which the harness failed.
    """
    lacking = [s.trial_id for s in scores if not s.is_judged] if unknown is None else list(unknown)
    check_one_run(scores)
    if not scores:
        return []
    ordered = sorted_scores(scores)
    tasks: dict[str, list[TrialScore]] = {}
    for score in ordered:
        tasks.setdefault(score.task_id, []).append(score)
    rows = [
        counts_of(task_id, task_name(group[0]), group, unknown=sum(task_of(trial) == task_id for trial in lacking))
        for task_id, group in tasks.items()
    ]
    return [*rows, counts_of(POOLED, "All trials", ordered, unknown=len(lacking))]


def counts_of(task_id: str, name: str, group: Sequence[TrialScore], *, unknown: int) -> SummaryRow:
    """``unknown``: planned trials without a verdict, those of ``group`` in which the harness failed included."""
    group = judged(group)
    return SummaryRow(
        task_id=task_id,
        name=name,
        n=len(group),
        unknown=unknown,
        success=sum(s.c3_success for s in group),
        region_correct=sum(s.region_correct for s in group),
        safety_gated=sum(s.safety_gated for s in group),
        medians={row.id: median(row.pooled(group)) for row in headlines()},
    )
