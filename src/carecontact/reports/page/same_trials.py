"""Words on the trials in which the policies beside a run were scored."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.reports.compare.baselines import Passed
from carecontact.reports.short_names import short_names


def same_trials(others: Sequence[Passed], n: int) -> str:
    """Return words that continue "other policies": whether they have the trials of the run.

    Args:
        others: at least one policy beside the run.
        n: trials of the run.
    """
    without = [row for row in others if not row.n_pairs]
    if len(without) == len(others):
        return "with other seeds: they have none of these trials"
    if not without:
        return "in the same trials" + ("" if all(row.n_pairs == n for row in others) else ", as far as they have them")
    short = short_names([row.policy for row in others])
    names = ", ".join(short[row.policy] for row in without)
    return f"in the same trials, as far as they have them, or, having none of these trials, with other seeds ({names})"
