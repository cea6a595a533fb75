"""Two runs compared from Python, as `carecontact compare` compares them."""

from __future__ import annotations

from pathlib import Path

from carecontact.programs.run import Run, load
from carecontact.reports.compare.comparable import check_different
from carecontact.reports.compare.comparison import Comparison, compare_runs


def compare(
    a: Run | str | Path, b: Run | str | Path, *, per_task: bool = False, allow_incomplete: bool = False
) -> Comparison:
    """Compare two runs trial by trial; every difference is a minus b (docs/statistics.md).

    Args:
        a: a run, or the place of one.
        b: the other run.
        per_task: whether to compare each task alone as well.
        allow_incomplete: whether to compare runs of which planned trials have no verdict, over those that there are.

    Returns what the command prints: ``overall`` has one line for each rate and score, ``per_task`` the lines of each
    task, and ``as_json()`` gives the content of ``comparison.json``.

    Raises ConfigError, naming what differs, if the runs must not be compared, are one run, or have no trial in common.
    """
    check_different([run.path if isinstance(run, Run) else Path(run) for run in (a, b)])
    of_a, of_b = (run if isinstance(run, Run) else load(run) for run in (a, b))
    return compare_runs(of_a.scored, of_b.scored, per_task=per_task, allow_incomplete=allow_incomplete)
