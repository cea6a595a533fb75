"""The table of rates: success, region-correct, safety-gated."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.compare.outcomes import RATES
from carecontact.reports.intervals import SEEDS_FOR_INTERVAL, enough_seeds
from carecontact.reports.paper.method import Method
from carecontact.reports.paper.table import ABSENT, Table
from carecontact.runs.pooling import rejected_text
from carecontact.stats import wilson_interval

Rate = tuple[float, float | None, float | None]
"""A rate in percent, and its interval where there is one."""
NUMBERS = (
    "method", "rate", "passed", "trials", "percent", "percent_low", "percent_high", "paper_percent",
    "paper_percent_low", "paper_percent_high",
)  # fmt: skip


def rates(methods: Sequence[Method], *, note: str | None = None) -> Table:
    """``note``: why the rates must not be set beside the paper's as they are."""
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[object, ...]] = []
    for method in methods:
        cells: list[str] = []
        for rate in RATES:
            n = len(method.scores)
            k = sum(bool(rate.of(score)) for score in method.scores)
            ours = _ours(k, n, interval=enough_seeds(method.scores))
            printed = method.published and _in_percent(*method.published.rates[rate.id])
            cells += [f"{k}/{n}", _shown(ours), _shown(printed) if printed else ABSENT]
            numbers.append((method.title, rate.id, k, n, *ours, *(printed or (None, None, None))))
        rows.append((method.title, *cells))
    head = [text for r in RATES for text in (f"{r.title}, n", f"{r.title} [%]", f"Paper: {r.title} [%]")]
    return Table(
        name="rates",
        caption="Rates with Wilson 95 % intervals",
        head=("Method", *head),
        rows=tuple(rows),
        notes=(
            "Each rate counts all planned trials. A method with fewer than "
            f"{SEEDS_FOR_INTERVAL} seeds has no intervals.",
            *filter(None, [note, *sorted({rejected_text(method.scores) for method in methods})]),
        ),
        numbers=(NUMBERS, *numbers),
    )


def _ours(k: int, n: int, *, interval: bool) -> Rate:
    found = wilson_interval(k, n)
    return _in_percent(k / n, *((found.low, found.high) if interval else (None, None)))


def _in_percent(share: float, low: float | None, high: float | None) -> Rate:
    # The last digits of a product of two floats say nothing.
    of = [None if value is None else round(100 * value, 6) for value in (low, high)]
    return round(100 * share, 6), of[0], of[1]


def _shown(rate: Rate) -> str:
    estimate, low, high = rate
    return f"{estimate:.1f}" + ("" if low is None or high is None else f" ({low:.1f}, {high:.1f})")
