"""Many runs on one engine, one after another: a cell of a sweep begins when those before it leave a slot free."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from carecontact.contract.policy import PolicyCard
from carecontact.hosting.setup import PolicySetup
from carecontact.runs.sweep.cells import Cell
from carecontact.trials import supervisor
from carecontact.trials.launch import Launcher
from carecontact.trials.supervisor import POLL_S, Run, RunSummary, TrialEvent

MOST_OPEN = 32
"""Cells whose folders are kept at once."""


@dataclass(frozen=True, kw_only=True)
class SweptPolicy:
    setup: PolicySetup
    card: PolicyCard | None
    jobs: int | None
    """Most trials at once of this policy and of those behind the same address; None: no limit."""


@dataclass(frozen=True, kw_only=True)
class _Open:
    cell: Cell
    run: Run
    kept: ExitStack


def run_cells(
    cells: Sequence[Cell],
    policies: Sequence[SweptPolicy],
    *,
    folder: Callable[[Cell], Path],
    jobs: int | None,
    on_event: Callable[[Cell, TrialEvent], None],
    on_done: Callable[[Cell, RunSummary], None],
    options: Mapping[str, Any],
) -> None:
    """Run what the cells' folders still lack. On KeyboardInterrupt the workers are killed; finished trials stay.

    Args:
        folder: where a cell is.
        jobs: trials at once over all cells; None: as many as the engine can run.
        on_done: called once for each cell that has ended, also for one that lacked nothing.
        options: further ones of ``supervisor.open_run``.

    Raises as ``run_trials``.
    """
    supervisor.check_jobs(jobs)
    waiting, opened, launcher = list(cells), list[_Open](), Launcher()

    def enter(cell: Cell) -> _Open:
        kept, policy = ExitStack(), policies[cell.policy]
        run = kept.enter_context(
            supervisor.open_run(
                cell.specs, out=folder(cell), policy=policy.setup, card=policy.card,
                on_event=lambda event: on_event(cell, event), launcher=launcher, **options,
            )
        )  # fmt: skip
        return _Open(cell=cell, run=run, kept=kept)

    try:
        while waiting or opened:
            _advance(opened, policies, jobs)
            for ended in [each for each in opened if not (each.run.waiting or each.run.running)]:
                opened.remove(ended)
                ended.kept.close()
                on_done(ended.cell, ended.run.summary())
            following = _following(waiting, opened, policies, jobs)
            if following is not None:
                waiting.remove(following)
                opened.append(enter(following))
            elif opened:
                time.sleep(POLL_S)
    finally:
        for each in opened:
            each.kept.close()
        launcher.close()


def _advance(opened: Sequence[_Open], policies: Sequence[SweptPolicy], jobs: int | None) -> None:
    """Give every open cell, in the order of the plan, as many trials as the slots and its policy allow."""
    for each in opened:
        free = min(_free(opened, jobs), _room(each.cell, policies, _busy(opened, policies)))
        each.run.advance(each.run.running + int(max(0, free)))


def _following(
    waiting: Sequence[Cell], opened: Sequence[_Open], policies: Sequence[SweptPolicy], jobs: int | None
) -> Cell | None:
    """Return the next cell whose trials could begin now; None while those of the open cells will take all that is
    free."""
    if not opened:
        return next(iter(waiting), None)
    busy, taken = _busy(opened, policies), 0.0
    for each in opened:
        will = max(0.0, min(each.run.waiting, _room(each.cell, policies, busy)))
        busy[_served_as(each.cell, policies)] += int(will)
        taken += will
    if _free(opened, jobs) <= taken or len(opened) >= MOST_OPEN:
        return None
    return next((cell for cell in waiting if _room(cell, policies, busy) > 0), None)


def _free(opened: Sequence[_Open], jobs: int | None) -> int:
    return (opened[0].run.slots() if jobs is None else jobs) - sum(each.run.running for each in opened)


def _served_as(cell: Cell, policies: Sequence[SweptPolicy]) -> str | int:
    """Return what the limit of trials at once is about: the address of a server, or the policy's place in the plan."""
    ref = policies[cell.policy].setup.ref
    return ref.text if ref.kind == "remote" else cell.policy


def _busy(opened: Sequence[_Open], policies: Sequence[SweptPolicy]) -> Counter[str | int]:
    """Server or policy -> its trials that run."""
    busy = Counter[str | int]()
    for each in opened:
        busy[_served_as(each.cell, policies)] += each.run.running
    return busy


def _room(cell: Cell, policies: Sequence[SweptPolicy], busy: Counter[str | int]) -> float:
    """Return how many more trials of the cell's policy may run."""
    jobs = policies[cell.policy].jobs
    return inf if jobs is None else jobs - busy[_served_as(cell, policies)]
