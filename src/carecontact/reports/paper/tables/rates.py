"""The table of rates: success, region-correct, safety-gated."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.compare.outcomes import RATES
from carecontact.reports.intervals import SEEDS_FOR_INTERVAL, enough_seeds
from carecontact.reports.paper.method import Method
from carecontact.reports.paper.table import ABSENT, Table
from carecontact.stats import wilson_interval


def rates(methods: Sequence[Method]) -> Table:
    rows: list[tuple[str, ...]] = []
    for method in methods:
        cells: list[str] = []
        for rate in RATES:
            n = len(method.scores)
            k = sum(bool(rate.of(score)) for score in method.scores)
            ours = _percent(k / n, *_interval(k, n)) if enough_seeds(method.scores) else f"{100 * k / n:.1f}"
            cells += [f"{k}/{n}", ours, _published(method, rate.id)]
        rows.append((method.title, *cells))
    head = [text for rate in RATES for text in (f"{rate.title}, n", f"{rate.title} [%]", "Paper [%]")]
    return Table(
        name="rates",
        caption="Rates with Wilson 95 % intervals",
        head=("Method", *head),
        rows=tuple(rows),
        notes=(
            "Each rate counts all trials; those in which the harness failed are left out. A method with fewer than "
            f"{SEEDS_FOR_INTERVAL} seeds has no intervals.",
        ),
    )


def _interval(k: int, n: int) -> tuple[float, float]:
    found = wilson_interval(k, n)
    return found.low, found.high


def _published(method: Method, rate: str) -> str:
    return ABSENT if method.published is None else _percent(*method.published.rates[rate])


def _percent(share: float, low: float, high: float) -> str:
    return f"{100 * share:.1f} ({100 * low:.1f}, {100 * high:.1f})"
