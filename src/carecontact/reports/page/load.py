"""What the person bore beside C1 to C5: a median of every further metric, task by task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carecontact.reports.table import NA, sorted_scores
from carecontact.runs.pooling import judged
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.result import TrialScore
from carecontact.stats import Median, median

FIRST = (
    "impulse@1", "force_rate_p95@1", "exposure_comfort@1", "exposure_gate@1", "exposure_pain@1", "pain_utilisation@1",
    "iso_utilisation@1", "shear_work@1", "beyond_calibrated@1", "force_predicted_r2@1",
)  # fmt: skip
"""Order of the rows that this package gives; those of other packages follow by name."""


@dataclass(frozen=True, kw_only=True)
class LoadRow:
    """One metric: a median for each task and, last, one over all trials."""

    id: str
    title: str
    """The metric's id where no row of the registry explains it."""
    unit: str
    """Empty for a plain number."""
    medians: tuple[Median, ...]

    def cells(self, contacts: Sequence[int]) -> list[str]:
        """One string a median; where it rests on another number of trials than ``contacts`` says, that number too."""
        return [
            rounded(m.estimate) + (f" (n={m.n_valid})" if m.estimate is not None and m.n_valid != n else "")
            for m, n in zip(self.medians, contacts, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class Load:
    tasks: tuple[str, ...]
    n: tuple[int, ...]
    """Trials of each task and, last, of all; harness errors left out."""
    contacts: tuple[int, ...]
    """Of them with valid contact."""
    rows: tuple[LoadRow, ...]


def load(scores: Sequence[TrialScore]) -> Load:
    """Over the trials that are ``judged``; no row without one that has further metrics."""
    counted = sorted_scores(judged(scores))
    tasks = tuple(dict.fromkeys(s.task_id for s in counted))
    groups = [*([s for s in counted if s.task_id == task] for task in tasks), counted]
    present = {id_ for s in counted for id_ in s.additional}
    ids = [*(id_ for id_ in FIRST if id_ in present), *sorted(present - set(FIRST))]
    return Load(
        tasks=tasks,
        n=tuple(map(len, groups)),
        contacts=tuple(sum(s.valid_contact for s in group) for group in groups),
        rows=tuple(_row(id_, groups) for id_ in ids),
    )


def rounded(value: float | None) -> str:
    """About three digits, never a power of ten: these numbers span four decades."""
    if value is None:
        return NA
    for below, digits in ((0.0005, 0), (10.0, 2), (100.0, 1)):
        if abs(value) < below:
            return f"{0.0 if digits == 0 else value:.{digits}f}"
    return f"{value:.0f}"


def _row(id_: str, groups: Sequence[Sequence[TrialScore]]) -> LoadRow:
    metric = METRICS[id_] if id_ in METRICS else None
    unit = metric.unit if metric else ""
    return LoadRow(
        id=id_,
        title=metric.title if metric else id_,
        unit="" if unit == "1" else unit,
        medians=tuple(median(s.additional.get(id_) for s in group) for group in groups),
    )
