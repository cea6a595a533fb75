"""What runs and sweeps print while they go, and of the trials that failed before their end."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from carecontact.cli.console import excerpt
from carecontact.errors import ConfigError, RecordingError, counted
from carecontact.recording import read_header
from carecontact.recording.reason import alike, ended_text, reason_of, remedies
from carecontact.recording.schema import EndReason, Failure
from carecontact.running.supervisor import RunSummary, TrialEvent
from carecontact.runs.results_file import RESULTS_NAME, read_results
from carecontact.runs.scorer import Scorer
from carecontact.runs.sweep import Cell
from carecontact.scoring.result import TrialScore
from carecontact.serving.conversation import WAIT_REPORT_S

HEARTBEAT_S = 30.0
"""Longest time without a line where there is no terminal for a bar [s]."""
MOST_WAITING = 4
"""Largest number of lines about silent policies that are shown at the same time."""
HARNESS_FAILED, POLICY_CRASHED = 1, 3
"""Exit status if the harness failed in a trial, and if only policies crashed."""
SHOWN, LOGS = 3, 3
"""Number of different failures that are printed with their tracebacks, and number of logs named for each."""


class Tally:
    """Counts the trials of a run as they end. Each is scored once, in the background."""

    def __init__(self, out: Path, scorer: Scorer) -> None:
        self._out, self._scorer = out, scorer
        self._began = time.monotonic()
        self._done = self._total = self._ran = 0
        self.passed = self.failed = self.crashed = self.harness_failed = 0
        self._last_c1 = ""
        self._running: dict[str, None] = {}
        self._silent: dict[str, tuple[float, str]] = {}

    def take(self, event: TrialEvent) -> None:
        trial = event.trial_id
        self._done, self._total = event.done, event.total
        if event.kind == "waiting":
            self._silent[trial] = time.monotonic(), event.message or ""
        if event.kind == "started":
            self._running[trial] = None
        if event.kind not in ("kept", "finished"):
            return
        self._running.pop(trial, None)
        self._silent.pop(trial, None)
        self._ran += event.kind == "finished"
        if event.ended == "process_failure":
            self.crashed += 1
        elif event.ended == "harness_error":
            self.harness_failed += 1
        elif event.kind == "kept":
            self._count(self._stored.get(trial))
        else:
            self._scorer.give(self._out / f"{trial}.h5", then=self._count_last)

    def counts(self) -> str:
        """Return the counts, such as ``5 passed, 6 failed, 1 crashed, last C1 12.3 N``."""
        harness = f"{self.harness_failed} failed in the harness" if self.harness_failed else ""
        parts = (f"{self.passed} passed", f"{self.failed} failed", f"{self.crashed} crashed", harness, self._last_c1)
        return ", ".join(filter(None, parts))

    def left(self) -> str:
        """Return the time left, such as ``about 14 min left``, or an empty text once every trial has ended."""
        if self._total and self._done == self._total:
            return ""
        if not self._ran:
            return "time left unknown"
        seconds = (time.monotonic() - self._began) / self._ran * (self._total - self._done)
        if seconds < 90:
            return f"about {seconds:.0f} s left"
        return f"about {seconds / 60:.0f} min left" if seconds < 5400 else f"about {seconds / 3600:.1f} h left"

    def waiting(self) -> list[str]:
        """Return one line for each trial whose policy does not answer, as the supervisor last reported it."""
        since = time.monotonic() - 2 * WAIT_REPORT_S
        return [f"{trial_id} {line}" for trial_id, (at, line) in list(self._silent.items()) if at > since]

    def lines(self) -> Iterator[str]:
        """Yield the counts, the silent policies, and the trials that have started and not ended."""
        yield self.counts()
        waiting = self.waiting()
        yield from waiting[:MOST_WAITING]
        if len(waiting) > MOST_WAITING:
            yield f"and {len(waiting) - MOST_WAITING} more wait for their policies"
        if self._running:
            yield f"running: {' '.join(self._running)}"

    def heartbeat(self) -> str:
        text = ", ".join(filter(None, (self.counts(), self.left())))
        return f"{time.monotonic() - self._began:6.0f} s [{self._done}/{self._total}] {text}"

    def wait(self) -> None:
        self._scorer.wait()

    def _count(self, score: TrialScore | None) -> None:
        if score is not None:
            self.passed += score.safety_gated
            self.failed += not score.safety_gated

    def _count_last(self, score: TrialScore | None) -> None:
        self._count(score)
        if score is not None:
            force = score.c1_peak_force_n
            self._last_c1 = "last trial without contact" if force is None else f"last C1 {force:.1f} N"

    @cached_property
    def _stored(self) -> dict[str, TrialScore]:
        with suppress(ConfigError, OSError):
            return {score.trial_id: score for score in read_results(self._out / RESULTS_NAME).scores}
        return {}


class RunBar(Progress):
    """The bar and the time left; under it, in lines of their own, what has no room beside it in 80 columns."""

    def __init__(self, tally: Tally, *, console: Console | None = None) -> None:
        self._tally = tally
        columns = (TextColumn("trials"), BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn())
        super().__init__(*columns, TextColumn("{task.description}"), console=console)
        self._row = self.add_task("", total=None)

    def get_renderables(self) -> Iterator[RenderableType]:
        yield from super().get_renderables()
        yield from (Text(line, no_wrap=True, overflow="ellipsis") for line in self._tally.lines())

    def show(self, event: TrialEvent) -> None:
        self._tally.take(event)
        if event.kind != "waiting" and (line := event_line(event)):
            self.console.print(line, highlight=False, markup=False)
        self.update(self._row, completed=event.done, total=event.total, description=self._tally.left())


class Silence:
    """Decides when to print that a policy does not answer: at once, and then every HEARTBEAT_S."""

    def __init__(self) -> None:
        self._seen: dict[str, float] = {}
        self._printed: dict[str, float] = {}

    def is_due(self, trial_id: str) -> bool:
        """Return whether to print a line now. Call this for every report of silence: if there is none for twice
        WAIT_REPORT_S, the policy has answered."""
        now = time.monotonic()
        lasts = now - self._seen.get(trial_id, -math.inf) < 2 * WAIT_REPORT_S
        self._seen[trial_id] = now
        if lasts and now - self._printed[trial_id] < HEARTBEAT_S:
            return False
        self._printed[trial_id] = now
        return True


def event_line(event: TrialEvent) -> str | None:
    texts = {"redo": f"runs again: {event.message}", "waiting": event.message}
    if event.kind == "finished":
        how = ended_text(event.ended) if event.ended else "ended"
        texts["finished"] = how + (f": {event.message}" if event.message else "")
    text = texts.get(event.kind)
    return None if text is None else f"[{event.done}/{event.total}] {event.trial_id} {text}"


@contextmanager
def progress(out: Path, scorer: Scorer) -> Iterator[Callable[[TrialEvent], None]]:
    """Yield the callback for ``run_trials``: a bar on a terminal; elsewhere lines, at least one in HEARTBEAT_S."""
    tally = Tally(out, scorer)
    if not sys.stdout.isatty():
        with _plain(tally) as show:
            yield show
        return
    with RunBar(tally) as bar:
        yield bar.show
        # The bar stays on the terminal, so that it has to count the last trial too.
        tally.wait()


@contextmanager
def _plain(tally: Tally) -> Iterator[Callable[[TrialEvent], None]]:
    began, kept = time.monotonic(), 0
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
        print_kept()
        line = event_line(event) if event.kind != "waiting" or silence.is_due(event.trial_id) else None
        if line:
            print(f"{time.monotonic() - began:6.0f} s {line}", flush=True)

    def print_kept() -> None:
        nonlocal kept
        if kept:
            print(f"{counted(kept, 'trial is', 'trials are')} finished already", flush=True)
        kept = 0

    threading.Thread(target=beat, daemon=True).start()
    try:
        yield show
        print_kept()
    finally:
        ended.set()


class SweepProgress:
    """What a sweep prints while it goes, and how its trials ended."""

    def __init__(self, *, cells: int, trials: int) -> None:
        self._cells, self._trials, self._silence = cells, trials, Silence()
        self._began = self._printed = time.monotonic()
        self._done_cells = self._done = self._ran = self._running = self._most = 0
        self._ended: Counter[EndReason] = Counter()
        self._warned: dict[int, str] = {}
        """Policy -> the cell whose first answer was printed. The policy answers alike in all cells."""

    def take(self, cell: Cell, event: TrialEvent) -> None:
        self._running += (event.kind == "started") - (event.kind in ("finished", "redo") and self._running > 0)
        self._most = max(self._most, self._running)
        self._ran += event.kind == "finished"
        if event.kind in ("kept", "finished"):
            self._done += 1
            self._ended.update([event.ended] if event.ended else [])
        line = None
        if event.kind == "redo" or event.ended in ("process_failure", "harness_error"):
            line = event_line(event)
        if event.kind == "waiting" and self._silence.is_due(f"{cell.name} {event.trial_id}"):
            line = event_line(event)
        if event.kind == "warned" and self._warned.setdefault(cell.policy, cell.name) == cell.name:
            line = f"warning: the first answer of {event.trial_id}, {event.message}"
        if line is not None:
            self._print(f"{cell.name}: {line}")
        elif time.monotonic() - self._printed > HEARTBEAT_S:
            self._print("")

    def done(self, cell: Cell, summary: RunSummary) -> None:
        self._done_cells += 1
        if summary.ran:
            self._print(f"{cell.name}: {counted(len(summary.ended), 'trial')}")

    def print_throughput(self, wall_s: float) -> None:
        if kept := self._done - self._ran:
            print(f"{counted(kept, 'trial was', 'trials were')} finished already")
        if self._ran:
            print(throughput(self._ran, wall_s, self._most))

    def status(self) -> int:
        return status_of(self._ended)

    def _print(self, line: str) -> None:
        self._printed = time.monotonic()
        counts = f"[{self._done_cells}/{self._cells} cells, {self._done}/{self._trials} trials]"
        print(f"{self._printed - self._began:6.0f} s {counts} {line}".rstrip(), flush=True)


def throughput(trials: int, wall_s: float, most_at_once: int) -> str:
    rate = f"{60 * trials / wall_s:.1f} a minute"
    return f"{counted(trials, 'trial')} in {wall_s:.0f} s, at most {most_at_once} at once: {rate}"


def status_of(ended: Mapping[EndReason, int], *, allow_failures: bool = False) -> int:
    """Return the exit status. Failures of the harness take precedence, because they leave trials without a result."""
    if ended.get("harness_error"):
        return HARNESS_FAILED
    return POLICY_CRASHED if ended.get("process_failure") and not allow_failures else 0


def print_failed(ended: Mapping[str, EndReason], *, out: Path, again: str) -> None:
    """Name what failed and where its logs are. ``again``: command that goes on with the run."""
    crashed = [trial for trial, how in ended.items() if how == "process_failure"]
    harness = [trial for trial, how in ended.items() if how == "harness_error"]
    if crashed:
        share = f"{len(crashed)} of {counted(len(ended), 'trial')}"
        print(f"the policy crashed in {share}; logs and report.html are in {out}")
        _print_groups(crashed, out, whole=True)
    if harness:
        print(f"{counted(len(harness), 'trial')} failed in the harness; logs are in {out}")
        _print_groups(harness, out, whole=False)
        print(f"to run them again: {again}")
    if crashed:
        print(
            "to run crashed trials again: --restart if you changed the policy, --retry-failed if it was not the cause"
        )


def _print_groups(trials: Sequence[str], out: Path, *, whole: bool) -> None:
    groups: dict[str, list[tuple[str, Failure]]] = defaultdict(list)
    for trial_id in sorted(trials):
        failure = _failure(out / f"{trial_id}.h5")
        groups[alike(reason_of(failure))].append((str(out / f"{trial_id}.log"), failure))
    for number, group in enumerate(sorted(groups.values(), key=len, reverse=True)):
        first = group[0][1]
        more = f" and {len(group) - LOGS} more" if len(group) > LOGS else ""
        logs = ", ".join(log for log, _ in group[:LOGS]) + more
        print(f"{counted(len(group), 'trial')}: {reason_of(first)}; see {logs}")
        for line in excerpt(first.message) if whole and number < SHOWN else ():
            print(line)
        for remedy in remedies(first.message) if whole else ():
            print(f"  hint: {remedy}")


def _failure(recording: Path) -> Failure:
    try:
        found = read_header(recording).failure
    except RecordingError as error:
        return Failure(kind="unread", message=str(error))
    return found or Failure(kind="unknown", message="no reason recorded")
