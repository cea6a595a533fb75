"""How hard and how long the person was touched: a median of every metric, task by task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carecontact.reports.table import sorted_scores
from carecontact.reports.text import NOT_DEFINED, shown
from carecontact.reports.units import shown_unit
from carecontact.runs.pooling import judged
from carecontact.scoring.metrics.metric import METRICS, Metric, described, newest
from carecontact.scoring.result import TrialScore
from carecontact.stats import Median, median


@dataclass(frozen=True, kw_only=True)
class LoadRow:
    """One metric: a median for each task and, last, one over all trials."""

    metric: Metric
    medians: tuple[Median, ...]

    @property
    def unit(self) -> str:
        """Unit of the cells; empty for a plain number."""
        return shown_unit(self.metric)[1]

    @property
    def label(self) -> str:
        """The metric's name and the unit of the cells."""
        return f"{self.metric.name} [{self.unit}]" if self.unit else self.metric.name

    def cells(self, contacts: Sequence[int]) -> list[str]:
        """Return one string per median; where it is over another number of trials than ``contacts`` says, that number
        too."""
        return [self._cell(found, n) for found, n in zip(self.medians, contacts, strict=True)]

    def _cell(self, found: Median, n: int) -> str:
        if not found.n:
            return NOT_DEFINED
        factor, unit = shown_unit(self.metric)
        value = None if found.estimate is None else factor * found.estimate
        text = shown(value, digits=self.metric.digits, unit=unit)
        return text + (f" (n={found.n_valid})" if found.estimate is not None and found.n_valid != n else "")


@dataclass(frozen=True, kw_only=True)
class Load:
    tasks: tuple[str, ...]
    n: tuple[int, ...]
    """Number of trials of each task and, last, of all tasks, without harness errors."""
    contacts: tuple[int, ...]
    """Number of these trials with valid contact."""
    rows: tuple[LoadRow, ...]


def load(scores: Sequence[TrialScore], *, headlines: bool = False) -> Load:
    """Return medians over the trials that are ``judged``.

    Args:
        headlines: whether the metrics that have a column of their own elsewhere have a row here too.
    """
    counted = sorted_scores(judged(scores))
    tasks = tuple(dict.fromkeys(s.task_id for s in counted))
    groups = [*([s for s in counted if s.task_id == task] for task in tasks), counted]
    return Load(
        tasks=tasks,
        n=tuple(map(len, groups)),
        contacts=tuple(sum(s.valid_contact for s in group) for group in groups),
        rows=tuple(
            LoadRow(metric=metric, medians=tuple(_median(metric, group) for group in groups))
            for metric in _metrics(counted)
            if metric.median and (headlines or not metric.headline)
        ),
    )


def _median(metric: Metric, group: Sequence[TrialScore]) -> Median:
    return median(metric.pooled([score for score in group if metric.concerns(score.action)]))


def _metrics(scores: Sequence[TrialScore]) -> list[Metric]:
    """Return the metrics by which any of these trials was scored, in the order of tables; of several versions, the
    newest."""
    further = newest({id_ for score in scores for id_ in score.additional})
    with_field = [metric for metric in METRICS.values() if metric.field is not None] if scores else []
    return sorted([*with_field, *map(described, further)], key=lambda metric: (metric.order, metric.id))
