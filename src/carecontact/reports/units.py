"""The units in which tables show the values of metrics."""

from __future__ import annotations

from carecontact.scoring.metrics.metric import Metric


def shown_unit(metric: Metric) -> tuple[float, str]:
    """Return a factor and the unit of a metric's values times this factor; the unit of a plain number is empty.

    A trial has few metres and joules, so that both are shown in thousandths.
    """
    if metric.unit in ("m", "J") and metric.digits is None:
        return 1000.0, f"m{metric.unit}"
    return 1.0, "" if metric.unit == "1" else metric.unit
