"""Places that move with a region of the person, ahead of a tool that lags behind its target."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.oracle.truth import Truth, displaced
from carecontact.policies.motion import CONTROL_HZ

F64 = npt.NDArray[np.float64]

RAMP_S = 2.0
"""Time [s] after the start in which the robot takes on the movement that it follows, because it begins at rest."""
SMOOTHING = 0.3
"""Share of the newest velocity of the skin in the exponential running mean of this velocity."""
MOST_LEAD_M = 0.03


class Follower:
    """Follows one region of the person. Call ``follow`` once in every control period."""

    def __init__(self, truth: Truth) -> None:
        impedance = truth.simulation.protocol.impedance
        # A critically damped spring whose target moves evenly lags by damping / stiffness seconds.
        self._lag_s = 2.0 * float(np.sqrt(impedance.effective_mass_kg / impedance.translational_n_m))
        self._truth = truth
        self._first = self._last = truth.frame()
        self._velocity = np.zeros(3)
        self._count = 0

    def follow(self, place: F64) -> F64:
        """Return where a target (3,) [m], planned when this object was made, belongs now that the region has moved."""
        now = self._truth.frame()
        moved, before = (displaced(place, self._first, frame) for frame in (now, self._last))
        self._last = now
        self._velocity += SMOOTHING * ((moved - before) * CONTROL_HZ - self._velocity)
        lead = self._lag_s * self._velocity
        lead *= min(1.0, MOST_LEAD_M / max(float(np.linalg.norm(lead)), 1e-9))
        self._count += 1
        return place + min(1.0, self._count / (RAMP_S * CONTROL_HZ)) * (moved + lead - place)
