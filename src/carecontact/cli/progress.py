"""What a run prints while it goes: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from carecontact.trials.supervisor import TrialEvent


def told(event: TrialEvent) -> str | None:
    """One line about an event, or None where a line would only be noise."""
    place = f"[{event.done}/{event.total}] {event.trial_id}"
    if event.kind == "redo":
        return f"{place} runs again: {event.message}"
    if event.kind == "finished":
        return f"{place} {event.ended}" + (f": {event.message}" if event.message else "")
    return None


@contextmanager
def progress() -> Iterator[Callable[[TrialEvent], None]]:
    """Yields the callback for run_trials."""
    if not sys.stdout.isatty():
        yield _plain()
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("trials"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns) as bar:
        row = bar.add_task("", total=None)
        active: dict[str, None] = {}

        def show(event: TrialEvent) -> None:
            if event.kind == "started":
                active[event.trial_id] = None
            elif event.kind == "finished":
                active.pop(event.trial_id, None)
            line = told(event)
            if line:
                bar.console.print(line, highlight=False, markup=False)
            bar.update(row, completed=event.done, total=event.total, description=" ".join(active))

        yield show


def _plain() -> Callable[[TrialEvent], None]:
    began = time.monotonic()
    kept = 0

    def show(event: TrialEvent) -> None:
        nonlocal kept
        if event.kind == "kept":
            kept += 1
            return
        if kept:
            print(f"{kept} trial(s) are finished already", flush=True)
            kept = 0
        line = told(event)
        if line:
            print(f"{time.monotonic() - began:6.0f} s {line}", flush=True)

    return show
