"""Calls functions when their time has come, in one thread for the whole process.

A call under a deadline thereby needs no thread of its own. A policy can use up the processes that its user may have,
and with them the threads; a deadline that is set afterwards still holds.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress


class Alarm:
    def __init__(self, alarms: Alarms, due: float, call: Callable[[], object], every_s: float | None) -> None:
        self.due = due
        """Time of ``time.monotonic`` [s]."""
        self._alarms, self._call, self._every_s = alarms, call, every_s
        self._ringing = threading.RLock()
        self._cancelled = False

    def cancel(self) -> None:
        """Make sure that the function is not called any more; wait for its end if it is just being called."""
        self._alarms.forget(self)
        with self._ringing:
            self._cancelled = True

    def ring(self) -> bool:
        """Call the function unless this was cancelled; return whether it is to be called again."""
        with self._ringing:
            if self._cancelled:
                return False
            try:
                self._call()
            except Exception:
                with suppress(Exception):  # Nobody may read what it prints.
                    threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))
                return False
        if self._every_s is not None:
            self.due = time.monotonic() + self._every_s
        return self._every_s is not None


class Alarms:
    """A thread, which starts with the first alarm or before, and its alarms. A function that blocks delays those of all
    other alarms of the same object."""

    def __init__(self) -> None:
        self._begin()
        if hasattr(os, "register_at_fork"):  # The thread stays in the parent.
            os.register_at_fork(after_in_child=self._begin)

    @property
    def runs(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Start the thread, if it does not run yet. Raises RuntimeError if it cannot be started."""
        with self._changed:
            if not self.runs:
                thread = threading.Thread(target=self._run, daemon=True)
                thread.start()
                self._thread = thread

    def set(self, after_s: float, call: Callable[[], object], *, every_s: float | None = None) -> Alarm:
        """Have a function called once after some time [s], and then, if ``every_s`` is given, at that interval [s]."""
        self.start()
        alarm = Alarm(self, time.monotonic() + after_s, call, every_s)
        self._add(alarm)
        return alarm

    def forget(self, alarm: Alarm) -> None:
        with self._changed:
            self._set.discard(alarm)

    def _begin(self) -> None:
        self._changed = threading.Condition()
        self._set = set[Alarm]()
        self._thread: threading.Thread | None = None
        self._wakes = math.inf

    def _add(self, alarm: Alarm) -> None:
        with self._changed:
            self._set.add(alarm)
            if alarm.due < self._wakes:
                self._changed.notify()

    def _run(self) -> None:
        while True:
            for alarm in self._due():
                if alarm.ring():
                    self._add(alarm)

    def _due(self) -> list[Alarm]:
        """Wait for the next alarms, and take them out."""
        with self._changed:
            while True:
                now = time.monotonic()
                if due := [alarm for alarm in self._set if alarm.due <= now]:
                    self._set.difference_update(due)
                    return due
                self._wakes = min((alarm.due for alarm in self._set), default=math.inf)
                self._changed.wait(None if self._wakes == math.inf else min(self._wakes - now, threading.TIMEOUT_MAX))


DEADLINES = Alarms()
"""Those that end a wait. Their functions never block."""
REPORTS = Alarms()
"""Those that say something, which may block, on a terminal for example."""
