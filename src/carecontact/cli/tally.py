"""Counts the finished trials of a run by result, and estimates when the run ends."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import ConfigError
from carecontact.hosting.conversation import WAIT_REPORT_S
from carecontact.trials.scorer import Scorer
from carecontact.trials.supervisor import TrialEvent

if TYPE_CHECKING:
    from carecontact.scoring.result import TrialScore


class Tally:
    """Counts the trials of a run as they end. Each is scored once, and nobody waits."""

    def __init__(self, out: Path, scorer: Scorer) -> None:
        """Make a tally without a trial.

        Args:
            out: folder of the run.
            scorer: scores the trials that run, which the tally gives it.
        """
        self._out, self._scorer = out, scorer
        self._earlier: dict[str, TrialScore] | None = None
        self._began = time.monotonic()
        self._done = self._total = self._ran = 0
        self.passed = self.failed = self.crashed = self.harness_failed = 0
        self._last_c1 = ""
        self._running: dict[str, None] = {}
        self._silent: dict[str, tuple[float, str]] = {}

    def take(self, event: TrialEvent) -> None:
        self._done, self._total = event.done, event.total
        if event.kind == "waiting":
            self._silent[event.trial_id] = time.monotonic(), event.message or ""
        if event.kind == "started":
            self._running[event.trial_id] = None
        if event.kind not in ("kept", "finished"):
            return
        self._running.pop(event.trial_id, None)
        self._silent.pop(event.trial_id, None)
        self._ran += event.kind == "finished"
        if event.ended == "process_failure":
            self.crashed += 1
        elif event.ended == "harness_error":
            self.harness_failed += 1
        elif event.kind == "kept":
            self._count(self._stored().get(event.trial_id), last=False)
        else:
            self._scorer.give(self._out / f"{event.trial_id}.h5", then=lambda score: self._count(score, last=True))

    def counts(self) -> str:
        """Return the counts, such as ``5 passed, 6 failed, 1 crashed, last C1 12.3 N``."""
        parts = [f"{self.passed} passed", f"{self.failed} failed", f"{self.crashed} crashed"]
        if self.harness_failed:
            parts.append(f"{self.harness_failed} failed in the harness")
        if self._last_c1:
            parts.append(self._last_c1)
        return ", ".join(parts)

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

    def running(self) -> list[str]:
        """Return the trials that have started and not ended."""
        return list(self._running)

    def heartbeat(self) -> str:
        told = ", ".join(filter(None, (self.counts(), self.left())))
        return f"{time.monotonic() - self._began:6.0f} s [{self._done}/{self._total}] {told}"

    def wait(self) -> None:
        """Wait until every trial is scored."""
        self._scorer.wait()

    def _count(self, score: TrialScore | None, *, last: bool) -> None:
        if score is None:
            return
        self.passed += score.safety_gated
        self.failed += not score.safety_gated
        if last:
            force = score.c1_peak_force_n
            self._last_c1 = "last trial without contact" if force is None else f"last C1 {force:.1f} N"

    def _stored(self) -> dict[str, TrialScore]:
        """Return the scores that an earlier command wrote."""
        if self._earlier is None:
            from carecontact.runs.results_file import RESULTS_NAME, read_results

            self._earlier = {}
            with suppress(ConfigError, OSError):
                self._earlier = {score.trial_id: score for score in read_results(self._out / RESULTS_NAME).scores}
        return self._earlier
