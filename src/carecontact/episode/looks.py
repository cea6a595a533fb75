"""Which cameras take a view for an observation: those that are due at their rate, and those that an action names."""

from __future__ import annotations

from collections.abc import Collection
from math import floor

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError
from carecontact.interface.observation import LastViews, Observation
from carecontact.interface.policy import CAMERAS, PolicyCard

ROUNDING_S = 1e-6
"""Less than this is rounding, when an observation comes exactly one physics step before an interval."""


def flags(cameras: Collection[str]) -> npt.NDArray[np.uint8]:
    """Return (V,) 1 for each of CAMERAS that is among ``cameras``, as recordings keep it."""
    return np.array([name in cameras for name in CAMERAS], np.uint8)


class Looks:
    """The cameras of one trial in time.

    A camera with a rate of r Hz is due in the first observation of each interval from k / r to (k + 1) / r. Control
    periods are whole physics steps, which may put an observation before the interval to which it belongs, by less than
    one step: it counts as inside. A view that an action asks for does not delay the next one that is due.
    """

    def __init__(self, card: PolicyCard, *, dt_s: float) -> None:
        """``dt_s``: length of a physics step [s]."""
        self._card, self._early_s = card, dt_s - ROUNDING_S
        self._interval: dict[str, int] = {}
        """Camera -> number of the interval in which it took its last view."""
        self._asked: set[str] = set()
        self._last = LastViews()

    def check(self, look: Collection[str]) -> None:
        """Raises ActionError for a camera that the card does not name."""
        if isinstance(look, str):
            raise ActionError(f'look: expected a tuple of cameras, such as ("{look}",), got "{look}"')
        if unknown := [name for name in look if name not in self._card.cameras]:
            raise ActionError(f"look: no camera {unknown[0]!r} on the card; valid: {', '.join(self._card.cameras)}")

    def ask(self, look: Collection[str]) -> None:
        """Let these cameras take a view for the next observation."""
        self._asked |= set(look)

    def due(self, sim_time_s: float) -> tuple[str, ...]:
        """Return the cameras that take a view for the observation at this time, in the order of the card."""
        taking = tuple(name for name in self._card.cameras if self._is_due(name, sim_time_s))
        self._interval |= {name: self._number(name, sim_time_s) for name in taking}
        self._asked.clear()
        return taking

    def completed(self, observation: Observation) -> Observation:
        """Return an observation of the cameras that were due with the last views of the others."""
        return self._last.completed(observation)

    def _is_due(self, name: str, sim_time_s: float) -> bool:
        if name in self._asked or name not in self._card.camera_hz or name not in self._interval:
            return True
        return self._number(name, sim_time_s) > self._interval[name]

    def _number(self, name: str, sim_time_s: float) -> int:
        return floor((sim_time_s + self._early_s) * self._card.camera_hz.get(name, 0.0))
