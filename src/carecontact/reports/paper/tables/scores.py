"""The table of medians: C1, C2 on Push, C4, C5."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.paper.method import Method
from carecontact.reports.paper.published import Paper
from carecontact.reports.paper.table import ABSENT, Table
from carecontact.stats import median

NUMBERS = ("method", "score", "unit", "median", "trials", "paper_median")


def scores(methods: Sequence[Method], paper: Paper, *, note: str | None = None) -> Table:
    outcomes = paper.scores()
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[object, ...]] = []
    for method in methods:
        cells: list[str] = []
        for outcome in outcomes:
            found = median(outcome.of(score) for score in method.scores if outcome.counts(score))
            ours = ABSENT if found.estimate is None else f"{_shown(outcome.id, found.estimate)} (n={found.n_valid})"
            printed = method.published.medians.get(outcome.id) if method.published else None
            cells += [ours, ABSENT if printed is None else _shown(outcome.id, printed)]
            numbers.append((method.title, outcome.id, outcome.unit, found.estimate, found.n_valid, printed))
        rows.append((method.title, *cells))
    units = ["" if outcome.unit == "1" else f" [{outcome.unit}]" for outcome in outcomes]
    head = [text for o, unit in zip(outcomes, units, strict=True) for text in (f"{o.id}{unit}", f"Paper: {o.id}{unit}")]
    return Table(
        name="scores",
        caption="Medians of the scores over the trials that have them",
        head=("Method", *head),
        rows=tuple(rows),
        notes=(
            "C2 is pooled over Push only. Lower is better for C1 and C5, higher for C2 and C4.",
            *filter(None, [note]),
        ),
        numbers=(NUMBERS, *numbers),
    )


def _shown(id_: str, value: float) -> str:
    """Return a value with as many digits as the paper prints."""
    return f"{value:.2e}" if id_ == "C2" else f"{value:.3f}" if id_ == "C4" else f"{value:.2f}"
