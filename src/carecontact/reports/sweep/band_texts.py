"""The spread over draws, as tables for people."""

from __future__ import annotations

from collections.abc import Mapping

from carecontact.reports.intervals import enough
from carecontact.reports.sweep.bands import Band, Bands
from carecontact.reports.table import headlines
from carecontact.reports.text import NA, percent, shown
from carecontact.scoring.metrics.metric import Metric


def spread_heads() -> list[str]:
    return ["policy", "task", "passed", *(metric.label for metric in headlines())]


def spread_rows(found: Bands, named: Mapping[str, str]) -> list[list[str]]:
    """``named``: policy -> its name with its role."""
    return [
        [
            named[one.policy],
            one.task,
            f"{one.passed}/{one.n}",
            *(_band(metric, one.bands[metric.id], of=one.n) for metric in headlines()),
        ]
        for one in found.spreads
    ]


def _band(metric: Metric, found: Band | None, *, of: int) -> str:
    if found is None:
        return NA
    low, middle, high = (
        shown(value, digits=metric.digits, unit=metric.unit) for value in (found.low, found.median, found.high)
    )
    between = f" [{low} to {high}]" if enough(found.n) else ""
    return f"{middle}{between}" + ("" if found.n == of else f" (n={found.n})")


def flip_heads() -> list[str]:
    return ["policies", "task", "passed", *(metric.name for metric in headlines())]


def flip_rows(found: Bands) -> list[list[str]]:
    names = ["passed", *(metric.id for metric in headlines())]
    return [[f"{one.a} - {one.b}", one.task, *(_share(one.by.get(name)) for name in names)] for one in found.flips]


def _share(found: tuple[int, int] | None) -> str:
    return NA if found is None else f"{found[0]}/{found[1]} ({percent(found[0] / found[1])})"
