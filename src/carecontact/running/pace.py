"""A fixed wall time between an answer of a policy and the next observation, so that the time reveals no contact.

The simulation of a period takes longer when the robot touches the person. A policy that waits for its next observation
could measure that. With a pace, the observation leaves when the pace has passed for each executed period, however soon
it is ready.

A process that has just slept for long may send a message later than one that was busy until now, because its memory is
in no cache any more. Therefore the last WARM_S of each wait are the same whatever came before: the message is made once
in vain, and the process does not sleep.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.recording.schema import Recording

BETWEEN, ACT, PACED = "wall/between_acts_s", "wall/act_s", "wall/pace"
"""Arrays of a recording: (A - 1,) wall time [s] from each answer until the next observation left; (A,) from when each
observation left until its answer came; (2,) the pace [s], and how many of these observations came late. Only a run with
a pace has the third."""
WARM_S = 0.1
"""Some ten times what it takes to make and send a message with every modality of one camera."""
MAX_PACE_S = 5.0
"""Longest pace: with the 1,500 observations that a trial can have at most, it takes 2 of the supervisor's 4 hours."""


def check_pace(pace_s: float | None) -> None:
    if pace_s is not None and not WARM_S < pace_s <= MAX_PACE_S:
        raise ConfigError(
            f"--pace {pace_s:g}: must be above {WARM_S:g} s, because an observation has to be ready {WARM_S:g} s "
            f"before it leaves, and at most {MAX_PACE_S:g} s"
        )


def late_in(recording: Recording) -> int:
    """Return how many observations of a trial came late; 0 without a pace."""
    return int(recording[PACED][1]) if PACED in recording.arrays else 0


class Pace:
    """Holds back the observations of one trial, and notes when they left."""

    def __init__(
        self,
        pace_s: float | None,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """``pace_s``: wall time [s] for each control period; None: nothing is held back."""
        self._pace_s, self._clock, self._sleep = pace_s, clock, sleep
        self._answered_s: float | None = None
        self._periods = 0
        self._left_s: float | None = None
        self._between_s: list[float] = []
        self._act_s: list[float] = []
        self._late = 0

    def answered(self, periods: int) -> None:
        """Note that an answer came whose execution takes this many control periods."""
        self._answered_s, self._periods = self._clock(), periods
        if self._left_s is not None:
            self._act_s.append(self._answered_s - self._left_s)

    def hold(self, rehearse: Callable[[], object] = lambda: None) -> None:
        """Return when the next observation may leave. One that is late, which means not ready WARM_S before its time,
        leaves after the next whole pace, so that the policy learns that it was late, and not by what fraction."""
        if self._answered_s is None:
            self._left_s = self._clock()
            return
        if self._pace_s is not None:
            needed = math.ceil((self._clock() - self._answered_s + WARM_S) / self._pace_s)
            self._late += needed > self._periods
            until = self._answered_s + max(needed, self._periods) * self._pace_s
            while (left := until - WARM_S - self._clock()) > 0:
                self._sleep(left)
            rehearse()
            while self._clock() < until:
                pass
        self._left_s = self._clock()
        self._between_s.append(self._left_s - self._answered_s)

    def arrays(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return the arrays that the recording keeps of the pace."""
        kept = {BETWEEN: np.array(self._between_s, "<f8"), ACT: np.array(self._act_s, "<f8")}
        if self._pace_s is not None:
            kept[PACED] = np.array([self._pace_s, self._late], "<f8")
        return kept
