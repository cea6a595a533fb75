"""What of two runs is compared, and which difference would matter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carecontact.reports.table import angle, number
from carecontact.scoring.metrics.metric import METRICS


@dataclass(frozen=True, kw_only=True)
class Outcome:
    id: str
    title: str
    unit: str
    """Of values and differences as they are printed."""
    better: Literal["higher", "lower"]
    field: str
    matters: float
    """A comparison that could have missed a difference of this size is underpowered; reasons in docs/statistics.md."""
    push_only: bool = False

    @property
    def is_rate(self) -> bool:
        return self.unit == "%"


def _score(metric: str, field: str, matters: float, *, push_only: bool = False) -> Outcome:
    row = METRICS[metric]
    assert row.better != "neither"
    return Outcome(
        id=metric.partition("@")[0],
        title=row.title,
        unit=row.unit,
        better=row.better,
        field=field,
        matters=matters,
        push_only=push_only,
    )


RATES = tuple(
    Outcome(id=id_, title=title, unit="%", better="higher", field=field, matters=0.2)
    for id_, title, field in (
        ("success", "Success", "c3_success"),
        ("region_correct", "Region-correct", "region_correct"),
        ("safety_gated", "Safety-gated", "safety_gated"),
    )
)
SCORES = (
    _score("C1@1", "c1_peak_force_n", 5.0),
    _score("C2@1", "c2_joint_margin_rad", 0.05, push_only=True),
    _score("C4@1", "c4_motion_activity", 0.1),
    _score("C5@1", "c5_force_sd_n", 1.0),
)


def plain_text(outcome: Outcome, value: float | None) -> str:
    """As many digits as the tables give the outcome, without the unit; rates in percent."""
    if outcome.unit == "%":
        return number(None if value is None else 100 * value, 1)
    return angle(value) if outcome.unit == "rad" else number(value, 3 if outcome.unit == "1" else 2)
