"""The scores of a run as the terminal shows them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carecontact.scoring.result import TrialScore

WIDTH = 120


def print_table(scores: Sequence[TrialScore]) -> None:
    """Counts by task, medians of every metric, and the counts that a success rate hides."""
    from carecontact.cli.console import console, plain_table
    from carecontact.reports.failures import only_crashes
    from carecontact.runs.pooling import judged

    table = plain_table()
    for header in ("task", "trials", "success", "region-correct", "safety-gated", "peak force [N]", "failures"):
        table.add_column(header, justify="left" if header in ("task", "failures") else "right")
    for task in sorted({s.task_id for s in scores}):
        table.add_row(*_task_cells([s for s in scores if s.task_id == task]))
    console(WIDTH).print(table)
    if only_crashes(judged(scores)):
        print("\nthe policy crashed in every trial before any contact, so that there are no medians")
    else:
        _print_medians(scores)
    _print_counts(scores)


def _task_cells(of_task: Sequence[TrialScore]) -> list[str]:
    from carecontact.runs.pooling import judged

    rows = judged(of_task)
    peaks = sorted(s.c1_peak_force_n for s in rows if s.c1_peak_force_n is not None)
    modes = Counter("crashed" if s.is_crash else s.failure_mode for s in rows if s.failure_mode)
    return [
        f"{of_task[0].task_id} {of_task[0].action} {of_task[0].region}",
        str(len(rows)),
        *(str(sum(getattr(s, field) for s in rows)) for field in ("c3_success", "region_correct", "safety_gated")),
        "NA" if not peaks else f"{peaks[0]:.1f}" if len(peaks) == 1 else f"{peaks[0]:.1f} to {peaks[-1]:.1f}",
        ", ".join(f"{count} {mode}" for mode, count in sorted(modes.items())),
    ]


def _print_medians(scores: Sequence[TrialScore]) -> None:
    from carecontact.cli.console import console, plain_table
    from carecontact.reports.load import load

    found = load(scores, headlines=True)
    if not found.rows:
        return
    table = plain_table()
    table.add_column("median")
    for task in (*found.tasks, "all"):
        table.add_column(task, justify="right")
    for row in found.rows:
        table.add_row(row.metric.label, *row.cells(found.contacts))
    print()
    console(WIDTH).print(table)


def _print_counts(scores: Sequence[TrialScore]) -> None:
    from carecontact.reports.limit_rows import limit_rows
    from carecontact.runs.aggregate import quadrants, valid_ratio
    from carecontact.runs.pooling import judged

    counted = judged(scores)
    if not counted:
        return
    touched = sum(s.valid_contact for s in counted)
    scored = valid_ratio(counted)["n"]
    print(f"\ntrials with a trajectory to score: {scored} of {len(counted)}; with valid contact: {touched}")
    print("; ".join(f"{name.replace('_', ' ')}: {k}" for name, k in quadrants(counted).items()))
    for row in limit_rows(counted, gamma=None):
        print(f"trials above a limit ({row.name}): {row.above.k} of {row.above.n}, of which {row.n_success} successful")
