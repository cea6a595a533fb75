"""What a run prints while it goes: a bar on a terminal; plain lines elsewhere, and one at least every 30 s."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from carecontact.cli.tally import Tally
from carecontact.trials.supervisor import TrialEvent

HEARTBEAT_S = 30.0


def told(event: TrialEvent) -> str | None:
    """One line about an event, or None where a line would only be noise."""
    place = f"[{event.done}/{event.total}] {event.trial_id}"
    if event.kind == "redo":
        return f"{place} runs again: {event.message}"
    if event.kind == "finished":
        return f"{place} {event.ended}" + (f": {event.message}" if event.message else "")
    return None


@contextmanager
def progress(out: Path) -> Iterator[Callable[[TrialEvent], None]]:
    """Yields the callback for run_trials. ``out``: folder of the run, whose finished trials are counted."""
    with _bar(out) if sys.stdout.isatty() else _plain(out) as show:
        yield show


@contextmanager
def _bar(out: Path) -> Iterator[Callable[[TrialEvent], None]]:
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

        def describe() -> None:
            bar.update(row, description=f"{tally.text()}; {' '.join(active)}")

        def show(event: TrialEvent) -> None:
            if event.kind == "started":
                active[event.trial_id] = None
            elif event.kind == "finished":
                active.pop(event.trial_id, None)
            tally.take(event)
            line = told(event)
            if line:
                bar.console.print(line, highlight=False, markup=False)
            bar.update(row, completed=event.done, total=event.total)
            describe()

        tally = Tally(out, on_score=describe)
        try:
            yield show
            # The bar stays on the terminal, so that it has to count the last trial too.
            tally.close(wait=True)
        finally:
            tally.close()


@contextmanager
def _plain(out: Path) -> Iterator[Callable[[TrialEvent], None]]:
    began = time.monotonic()
    kept = 0
    tally, ended = Tally(out), threading.Event()

    def beat() -> None:
        while not ended.wait(HEARTBEAT_S):
            print(tally.heartbeat(), flush=True)

    def show(event: TrialEvent) -> None:
        nonlocal kept
        tally.take(event)
        if event.kind == "kept":
            kept += 1
            return
        say_kept()
        line = told(event)
        if line:
            print(f"{time.monotonic() - began:6.0f} s {line}", flush=True)

    def say_kept() -> None:
        nonlocal kept
        if kept:
            print(f"{kept} trial(s) are finished already", flush=True)
        kept = 0

    threading.Thread(target=beat, daemon=True).start()
    try:
        yield show
        say_kept()
    finally:
        ended.set()
        tally.close()
