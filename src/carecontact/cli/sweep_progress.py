"""What ``carecontact sweep`` prints while it goes."""

from __future__ import annotations

import time

from carecontact.cli.failed_trials import HARNESS_FAILED, POLICY_CRASHED
from carecontact.cli.progress import HEARTBEAT_S, Silence, told
from carecontact.cli.run import throughput
from carecontact.errors import counted
from carecontact.runs.sweep.cells import Cell
from carecontact.trials.supervisor import RunSummary, TrialEvent


class SweepProgress:
    """What a sweep prints while it goes, and how its trials ended."""

    def __init__(self, *, cells: int, trials: int) -> None:
        self._cells, self._trials, self._silence = cells, trials, Silence()
        self._began = self._told = time.monotonic()
        self._done_cells = self._done = self._ran = self._most = 0
        self._running = 0
        self._ended: dict[str, int] = {}
        self._warned: dict[int, str] = {}
        """Policy -> the cell whose first answer was printed. The policy answers alike in all cells."""

    def take(self, cell: Cell, event: TrialEvent) -> None:
        self._running += (event.kind == "started") - (event.kind in ("finished", "redo") and self._running > 0)
        self._most = max(self._most, self._running)
        self._done += event.kind in ("kept", "finished")
        self._ran += event.kind == "finished"
        failed = event.ended in ("process_failure", "harness_error")
        if event.kind in ("kept", "finished") and event.ended is not None:
            self._ended[event.ended] = self._ended.get(event.ended, 0) + 1
        line = told(event) if event.kind == "redo" or failed else None
        if event.kind == "waiting" and self._silence.is_due(f"{cell.name} {event.trial_id}"):
            line = told(event)
        if event.kind == "warned" and self._warned.setdefault(cell.policy, cell.name) == cell.name:
            line = f"warning: the first answer of {event.trial_id}, {event.message}"
        if line is not None:
            self._say(f"{cell.name}: {line}")
        elif time.monotonic() - self._told > HEARTBEAT_S:
            self._say("")

    def done(self, cell: Cell, summary: RunSummary) -> None:
        self._done_cells += 1
        if summary.ran:
            self._say(f"{cell.name}: {counted(len(summary.ended), 'trial')}")

    def say_throughput(self, wall_s: float) -> None:
        kept = self._done - self._ran
        if kept:
            print(f"{counted(kept, 'trial was', 'trials were')} finished already")
        if self._ran:
            print(throughput(self._ran, wall_s, self._most))

    def status(self) -> int:
        if self._ended.get("harness_error"):
            return HARNESS_FAILED
        return POLICY_CRASHED if self._ended.get("process_failure") else 0

    def _say(self, line: str) -> None:
        self._told = time.monotonic()
        counts = f"[{self._done_cells}/{self._cells} cells, {self._done}/{self._trials} trials]"
        print(f"{self._told - self._began:6.0f} s {counts} {line}".rstrip(), flush=True)
