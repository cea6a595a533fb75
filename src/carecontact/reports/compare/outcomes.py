"""What of two runs is compared, and which difference would matter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from carecontact.reports.text import number, shown
from carecontact.scoring.metrics.metric import Metric, metrics_in_order
from carecontact.scoring.result import TrialScore


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A rate, or a metric of which a difference matters."""

    id: str
    title: str
    unit: str
    """Unit of values and differences as they are printed."""
    better: Literal["higher", "lower"]
    field: str
    """Field of a trial's score, or the id under ``additional`` of a metric without a field of its own."""
    matters: float
    """A comparison that could have missed a difference of this size is underpowered; reasons in docs/statistics.md."""
    actions: tuple[str, ...] | None = None
    """Trials of these actions alone are compared; None: all."""
    digits: int | None = None

    @property
    def is_rate(self) -> bool:
        return self.unit == "%"

    def of(self, score: TrialScore) -> float | None:
        """Return the score's value; None for NA."""
        return getattr(score, self.field) if self.field in TrialScore.model_fields else score.additional.get(self.field)

    def counts(self, score: TrialScore) -> bool:
        """Whether this outcome is compared over a trial like this one."""
        return self.actions is None or score.action in self.actions

    def is_in(self, scores: Iterable[TrialScore]) -> bool:
        """Whether all of these trials were scored by it, with a value or with NA."""
        return self.field in TrialScore.model_fields or all(self.field in score.additional for score in scores)


RATES = tuple(
    Outcome(id=id_, title=title, unit="%", better="higher", field=field, matters=0.2, digits=1)
    for id_, title, field in (
        ("success", "Success", "c3_success"),
        ("region_correct", "Region-correct", "region_correct"),
        ("safety_gated", "Safety-gated", "safety_gated"),
    )
)


def score_outcomes() -> list[Outcome]:
    """Return one outcome for each registered metric that says which difference matters."""
    return [_outcome(row, row.matters) for row in metrics_in_order() if row.matters is not None]


def plain_text(outcome: Outcome, value: float | None) -> str:
    """Return a value with as many digits as the tables give the outcome, and without the unit; rates are in percent."""
    if outcome.is_rate:
        return number(None if value is None else 100 * value, 1)
    return shown(value, digits=outcome.digits, unit=outcome.unit)


def _outcome(metric: Metric, matters: float) -> Outcome:
    assert metric.better != "neither"
    return Outcome(
        id=metric.name,
        title=metric.title,
        unit=metric.unit,
        better=metric.better,
        field=metric.field or metric.id,
        matters=matters,
        actions=metric.actions,
        digits=metric.digits,
    )
