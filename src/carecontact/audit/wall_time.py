"""Part (g) tests whether the wall time between two acts, as recordings hold it, tells contact from no contact.

In a run without a pace they do, because a period with contact takes longer to simulate: the audit reports this, and
the run does not fail. A run that claims a pace fails if its times reveal contact nevertheless.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.audit.finding import TIME, Finding, Part
from carecontact.errors import counted
from carecontact.recording.schema import Recording
from carecontact.running.pace import BETWEEN, PACED

TELLS = 0.1
"""Distance of the area under the curve (AUC) from 0.5 at which times count as revealing contact. At an AUC of 0.6, a
policy guesses right in 60 of 100 pairs of periods."""
SURE_Z = 3.3
"""The AUC must also differ from 0.5 by so many standard errors, which happens by chance in 1 of 1,000 runs."""


@dataclass(frozen=True, kw_only=True)
class Times:
    per_period_s: npt.NDArray[np.float64]
    """(n,) wall time [s] for each control period: the time from an answer until the next observation was sent, divided
    by the number of its control periods."""
    contact: npt.NDArray[np.bool_]
    """(n,) whether the robot touched the person meanwhile."""


@dataclass(frozen=True, kw_only=True)
class Separation:
    """How well the wall times of many trials distinguish contact from no contact."""

    auc: float
    """Probability that, of two intervals of one trial, the one with contact took longer; NaN where no trial has
    both."""
    z: float
    """Distance of ``auc`` from 0.5 in standard errors, computed as if the intervals were independent."""

    @property
    def tells(self) -> bool:
        return abs(self.auc - 0.5) >= TELLS and abs(self.z) >= SURE_Z


def times_of(recording: Recording) -> Times:
    """Return the times that a recording holds; none for a trial without a policy's process."""
    between = recording.arrays.get(BETWEEN, np.zeros(0))
    shown, steps = recording["policy/observation_time_s"], recording["scorer/time_s"]
    count = min(len(between), max(len(shown) - 1, 0))
    periods = np.bincount(recording["actions/observation_index"], minlength=len(shown))[:count]
    touched = recording["scorer/normal_force"].max(1, initial=0.0) > 0.0
    # Cumulative sums start before the first step, so that a sum over no steps is 0.
    before = np.concatenate([[0], np.cumsum(touched)])
    edges = before[np.searchsorted(steps, shown[: count + 1])]
    kept = periods > 0
    return Times(per_period_s=(between[:count] / np.maximum(periods, 1))[kept], contact=(np.diff(edges) > 0)[kept])


def separation(trials: Iterable[Times]) -> Separation:
    """Compare intervals within each trial only, because machine and load differ between trials."""
    wins = pairs = variance = 0.0
    for times in trials:
        with_, without = times.per_period_s[times.contact], times.per_period_s[~times.contact]
        n = len(with_) * len(without)
        if n == 0:
            continue
        order = np.sort(without)
        wins += (np.searchsorted(order, with_, "left") + np.searchsorted(order, with_, "right")).sum() / 2
        pairs += n
        variance += n * (len(with_) + len(without) + 1) / 12
    if pairs == 0:
        return Separation(auc=math.nan, z=0.0)
    return Separation(auc=wins / pairs, z=(wins - pairs / 2) / math.sqrt(variance))


def audit_time(recordings: Iterable[Recording]) -> Part:
    free: list[Times] = []
    paced: list[Times] = []
    policy, late = "", 0
    for recording in recordings:
        policy = recording.header.spec.policy
        claims = PACED in recording.arrays
        (paced if claims else free).append(times_of(recording))
        late += int(recording[PACED][1]) if claims else 0
    found = {kind: separation(of) for kind, of in (("without a pace", free), ("with a pace", paced)) if of}
    leaks: list[Finding] = []
    if paced and found["with a pace"].tells:
        cause = f"; {counted(late, 'observation')} came late: give a longer --pace" if late else ""
        leaks.append(Finding(policy, "wall time between two acts", _words(found["with a pace"]) + cause))
    return Part(
        name=TIME,
        counts={"recordings": len(free) + len(paced)},
        findings=tuple(leaks),
        notes=tuple(f"{kind}: {_words(one)}" for kind, one in found.items()),
        nothing_to_examine=all(math.isnan(one.auc) for one in found.values()),
    )


def _words(found: Separation) -> str:
    if math.isnan(found.auc):
        return "nothing to examine, because no trial has intervals both with and without contact"
    verdict = "tells contact" if found.tells else "does not tell contact"
    return f"wall time {verdict} (AUC {found.auc:.2f}, {found.z:+.1f} standard errors from 0.5)"
