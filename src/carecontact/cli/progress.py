"""What a run prints while it goes: a bar on a terminal; plain lines elsewhere, at least one in 30 s, and one as soon as
a policy is silent."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from carecontact.cli.tally import Tally
from carecontact.errors import counted
from carecontact.hosting.conversation import WAIT_REPORT_S
from carecontact.recording.reason import ended_text
from carecontact.trials.scorer import Scorer
from carecontact.trials.supervisor import TrialEvent

HEARTBEAT_S = 30.0


def told(event: TrialEvent) -> str | None:
    """Return one line about an event, or None for an event that needs no line."""
    place = f"[{event.done}/{event.total}] {event.trial_id}"
    if event.kind == "redo":
        return f"{place} runs again: {event.message}"
    if event.kind == "finished":
        how = ended_text(event.ended) if event.ended else "ended"
        return f"{place} {how}" + (f": {event.message}" if event.message else "")
    if event.kind == "waiting":
        return f"{place} {event.message}"
    return None


@contextmanager
def progress(out: Path, scorer: Scorer) -> Iterator[Callable[[TrialEvent], None]]:
    """Yield the callback for ``run_trials``.

    Args:
        out: folder of the run, whose finished trials are counted.
        scorer: is given each of them.
    """
    tally = Tally(out, scorer)
    with _bar(tally) if sys.stdout.isatty() else _plain(tally) as show:
        yield show


@contextmanager
def _bar(tally: Tally) -> Iterator[Callable[[TrialEvent], None]]:
    from carecontact.cli.run_bar import RunBar

    with RunBar(tally) as bar:

        def show(event: TrialEvent) -> None:
            tally.take(event)
            line = told(event) if event.kind != "waiting" else None
            if line:
                bar.console.print(line, highlight=False, markup=False)
            bar.advance_to(event.done, event.total)

        yield show
        # The bar stays on the terminal, so that it has to count the last trial too.
        tally.wait()


class Silence:
    """Decides when to print that a policy does not answer: at once, and then every HEARTBEAT_S."""

    def __init__(self) -> None:
        self._seen: dict[str, float] = {}
        self._told: dict[str, float] = {}

    def is_due(self, trial_id: str) -> bool:
        """Return whether to print a line now. Call this for every report of silence: if there is none for twice
        WAIT_REPORT_S, the policy has answered."""
        now = time.monotonic()
        lasts = now - self._seen.get(trial_id, -math.inf) < 2 * WAIT_REPORT_S
        self._seen[trial_id] = now
        if lasts and now - self._told[trial_id] < HEARTBEAT_S:
            return False
        self._told[trial_id] = now
        return True


@contextmanager
def _plain(tally: Tally) -> Iterator[Callable[[TrialEvent], None]]:
    began = time.monotonic()
    kept = 0
    silence, ended = Silence(), threading.Event()

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
        line = told(event) if event.kind != "waiting" or silence.is_due(event.trial_id) else None
        if line:
            print(f"{time.monotonic() - began:6.0f} s {line}", flush=True)

    def say_kept() -> None:
        nonlocal kept
        if kept:
            print(f"{counted(kept, 'trial is', 'trials are')} finished already", flush=True)
        kept = 0

    threading.Thread(target=beat, daemon=True).start()
    try:
        yield show
        say_kept()
    finally:
        ended.set()
