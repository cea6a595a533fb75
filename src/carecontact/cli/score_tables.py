"""The scores of a run as the terminal shows them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from carecontact.contract.protocol import Protocol
    from carecontact.reports.table import SummaryRow
    from carecontact.runs.run_scores import RunScores
    from carecontact.scoring.result import TrialScore

WIDTH = 120
"""Width of the tables if the output does not go to a terminal [columns]."""


def print_table(run: RunScores, protocol: Protocol | None) -> None:
    """Print counts by task, medians of every metric, and the counts that a success rate hides.

    Args:
        run: at least one score.
        protocol: the run's protocol, from one of its recordings; None if none could be read.
    """
    from carecontact.cli.console import console, plain_table
    from carecontact.reports.failures import only_crashes
    from carecontact.reports.table import summary_rows
    from carecontact.runs.pooling import judged

    scores, terminal, table = run.scores, console(WIDTH), plain_table()
    for header in ("task", "trials", "success", "region-\ncorrect", "safety-\ngated", "peak force\n[N]"):
        table.add_column(header, justify="left" if header == "task" else "right")
    *rows, whole = summary_rows(scores, run.unjudged)
    tasks = [row.task_id for row in rows]
    for row in rows:
        of_task = [s for s in scores if s.task_id == row.task_id]
        table.add_row(f"{row.task_id} {row.name.lower()}", *_counts(row), _peaks(of_task))
    terminal.print(table)
    if run.incomplete:
        passed = whole.share(whole.safety_gated)
        told = f"{run.incomplete}: {passed} safety-gated, from all others failed to all others passed; {run.completing}"
        terminal.print(told, soft_wrap=True)
    modes = {task: _modes([s for s in judged(scores) if s.task_id == task]) for task in tasks}
    if any(modes.values()):
        terminal.print("\nfailures", style="bold")
        for task in tasks:
            if modes[task]:
                terminal.print(f"{task}: {modes[task]}")
    if only_crashes(judged(scores)):
        terminal.print("\nthe policy crashed in every trial before any contact, so that there are no medians")
    else:
        _print_medians(scores, terminal)
    _print_counts(run, protocol, terminal)


def _counts(row: SummaryRow) -> list[str]:
    """Return the trials, and how many of them passed each gate: ``9–12`` where three have no verdict."""
    passed = (row.success, row.region_correct, row.safety_gated)
    return [row.trials, *(row.share(k).partition("/")[0] for k in passed)]


def _peaks(of_task: Sequence[TrialScore]) -> str:
    from carecontact.runs.pooling import judged

    peaks = sorted(s.c1_peak_force_n for s in judged(of_task) if s.c1_peak_force_n is not None)
    return "NA" if not peaks else f"{peaks[0]:.1f}" if len(peaks) == 1 else f"{peaks[0]:.1f} to {peaks[-1]:.1f}"


def _modes(scores: Sequence[TrialScore]) -> str:
    found = Counter("crashed" if s.is_crash else s.failure_mode.replace("_", " ") for s in scores if s.failure_mode)
    return ", ".join(f"{count} {mode}" for mode, count in sorted(found.items()))


def _print_medians(scores: Sequence[TrialScore], terminal: Console) -> None:
    """Print the medians in as many tables, one below another, as the width needs."""
    from carecontact.cli.console import plain_table
    from carecontact.reports.load import load

    found = load(scores, headlines=True)
    if not found.rows:
        return
    labels = ["median", *(row.label for row in found.rows)]
    cells = [row.cells(found.contacts) for row in found.rows]
    columns = [list(column) for column in zip((*found.tasks, "all"), *cells, strict=True)]
    while columns:
        table, left = plain_table(), terminal.width - max(map(len, labels))
        table.add_column(labels[0], no_wrap=True)
        shown = 0
        for column in columns:
            left -= max(map(len, column)) + 2
            if left < 0 and shown:
                break
            table.add_column(column[0], justify="right", no_wrap=True)
            shown += 1
        for label, *row in zip(labels[1:], *(column[1:] for column in columns[:shown]), strict=True):
            table.add_row(label, *row)
        terminal.print()
        terminal.print(table)
        columns = columns[shown:]


def _print_counts(run: RunScores, protocol: Protocol | None, terminal: Console) -> None:
    from carecontact.cli.console import plain_table
    from carecontact.reports.joint_words import joint_counts
    from carecontact.reports.limit_rows import limit_rows
    from carecontact.reports.nursing import nursing_rows
    from carecontact.runs.aggregate import quadrants, valid_ratio
    from carecontact.runs.pooling import judged, share
    from carecontact.scoring.limits import footnote

    counted = judged(run.scores)
    if not counted:
        return
    if run.incomplete:
        terminal.print(f"\n{run.incomplete}; of these:")
    touched = sum(s.valid_contact for s in counted)
    scored = valid_ratio(counted)["n"]
    of_all = share(scored, len(counted), len(run.unjudged))
    terminal.print(f"\ntrials with a trajectory to score: {of_all}; with valid contact: {touched}")
    *found, crashed = quadrants(counted).items()
    terminal.print("; ".join(f"{name.replace('_', ' ')}: {k}" for name, k in found))
    over = sum(s.is_crash and bool(s.over_limit) for s in counted)
    terminal.print(f"crashed: {crashed[1]}" + (f", {over} of them after a force above the safety gate" if over else ""))
    for row in nursing_rows(counted, protocol):
        terminal.print(f"{row.title} ({row.metric}): {row.yes} of {row.n}")
    if joints := joint_counts(counted):
        terminal.print(joints)
    rows = limit_rows(counted, gamma=None, unknown=len(run.unjudged))
    if not rows:
        return
    table = plain_table()
    for header in ("limit", "trials\nabove", "of them\nsuccessful"):
        table.add_column(header, justify="left" if header == "limit" else "right")
    for row in rows:
        table.add_row(row.name, row.count, str(row.n_success))
    terminal.print()
    terminal.print(table)
    if note := footnote(row.name for row in rows):
        terminal.print(note)
