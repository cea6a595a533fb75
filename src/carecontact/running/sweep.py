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

from carecontact.interface.policy import PolicyCard
from carecontact.running import supervisor
from carecontact.running.supervisor import POLL_S, Run, RunSummary, TrialEvent
from carecontact.running.workers import Launcher
from carecontact.runs.sweep import Cell
from carecontact.serving.conversation import PolicySetup

MOST_OPEN = 32
"""Cells whose folders are kept at once."""


@dataclass(frozen=True, kw_only=True)
class SweptPolicy:
    setup: PolicySetup
    card: PolicyCard | None
    jobs: int | None
    """Most trials at once of this policy and of those behind the same address; None: no limit."""

    @property
    def place(self) -> str | int:
        """What ``jobs`` limits: the address of a server, or a policy of the plan."""
        return self.setup.ref.text if self.setup.ref.kind == "remote" else id(self)

    def room(self, busy: Counter[str | int]) -> float:
        """Return how many more trials of the policy may run. ``busy``: place -> trials that run there."""
        return inf if self.jobs is None else self.jobs - busy[self.place]


@dataclass(frozen=True, kw_only=True)
class _Open:
    cell: Cell
    policy: SweptPolicy
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

    If the server of a policy stays out of reach, no further cell of this server begins; the others go on.

    Args:
        folder: where a cell is.
        jobs: trials at once over all cells; None: as many as the engine can run.
        on_done: called once for each cell that has ended, also for one that lacked nothing.
        options: further ones of ``supervisor.open_run``.
    """
    supervisor.check_jobs(jobs)
    waiting, opened, launcher = list(cells), list[_Open](), Launcher()

    def enter(cell: Cell) -> _Open:
        kept, policy = ExitStack(), policies[cell.policy]
        given = {"policy": policy.setup, "card": policy.card, "launcher": launcher, **options}
        run = supervisor.open_run(cell.specs, out=folder(cell), on_event=lambda event: on_event(cell, event), **given)
        return _Open(cell=cell, policy=policy, run=kept.enter_context(run), kept=kept)

    try:
        while waiting or opened:
            _advance(opened, jobs)
            for ended in [each for each in opened if not (each.run.waiting or each.run.running)]:
                opened.remove(ended)
                ended.kept.close()
                summary = ended.run.summary()
                if summary.unreached is not None:
                    waiting = [cell for cell in waiting if policies[cell.policy].place != ended.policy.place]
                on_done(ended.cell, summary)
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


def _advance(opened: Sequence[_Open], jobs: int | None) -> None:
    """Give every open cell, in the order of the plan, as many trials as the slots and its policy allow."""
    for each in opened:
        free = min(_free(opened, jobs), each.policy.room(_busy(opened)))
        each.run.advance(each.run.running + int(max(0, free)))


def _following(
    waiting: Sequence[Cell], opened: Sequence[_Open], policies: Sequence[SweptPolicy], jobs: int | None
) -> Cell | None:
    """Return the next cell whose trials could begin now; None while the open cells will take all that is free."""
    if not opened:
        return next(iter(waiting), None)
    busy, taken = _busy(opened), 0
    for each in opened:
        begins = int(max(0.0, min(each.run.waiting, each.policy.room(busy))))
        busy[each.policy.place] += begins
        taken += begins
    if _free(opened, jobs) <= taken or len(opened) >= MOST_OPEN:
        return None
    return next((cell for cell in waiting if policies[cell.policy].room(busy) > 0), None)


def _free(opened: Sequence[_Open], jobs: int | None) -> int:
    return (opened[0].run.engine.slots() if jobs is None else jobs) - sum(each.run.running for each in opened)


def _busy(opened: Sequence[_Open]) -> Counter[str | int]:
    busy = Counter[str | int]()
    for each in opened:
        busy[each.policy.place] += each.run.running
    return busy
