"""The table of tests between two methods, unpaired as in the paper."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.compare.outcomes import RATES
from carecontact.reports.paper.method import Method
from carecontact.reports.paper.published import Paper
from carecontact.reports.paper.table import ABSENT, Table
from carecontact.stats import fisher_exact, mann_whitney

PAIR = ("state-machine", "voxposer")
"""The methods that the paper tests against each other."""


def contrasts(methods: Sequence[Method], paper: Paper, *, note: str | None = None) -> Table | None:
    """Return the tests between the paper's two methods if both are there, and otherwise between the first two; None
    where there is only one method."""
    if len(methods) < 2:
        return None
    by_policy = {method.policy: method for method in reversed(methods)}
    as_printed = all(policy in by_policy for policy in PAIR)
    a, b = (by_policy[policy] for policy in PAIR) if as_printed else methods[:2]
    rows: list[tuple[str, ...]] = []
    outcomes = {outcome.id: outcome for outcome in (*RATES, *paper.scores())}
    for id_, (test, printed) in paper.pvalues.items():
        outcome = outcomes[id_]
        values = [[outcome.of(s) for s in method.scores if outcome.counts(s)] for method in (a, b)]
        rows.append((outcome.title, test, _p(test, *values), f"{printed:.2e}" if as_printed else ABSENT))
    return Table(
        name="tests",
        caption=f"{a.title} against {b.title}, unpaired",
        head=("Outcome", "Test", "p", "Paper: p"),
        rows=tuple(rows),
        notes=(
            "Rates use all trials, scores those that have them. `carecontact compare` pairs the trials by their seeds, "
            "which needs fewer of them.",
            *filter(None, [note if as_printed else None]),
        ),
    )


def _p(test: str, first: Sequence[float | None], second: Sequence[float | None]) -> str:
    if test == "Fisher exact":
        found = fisher_exact(sum(map(bool, first)), len(first), sum(map(bool, second)), len(second)).pvalue
        return f"{found:.2e}"
    a, b = ([value for value in values if value is not None] for values in (first, second))
    return f"{mann_whitney(a, b).pvalue:.2e}" if a and b else ABSENT
