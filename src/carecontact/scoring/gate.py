"""What a trial achieved, in the quantities that the gates limit, and whether it meets its gate."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.scoring.progress import Episode


@dataclass(frozen=True, kw_only=True)
class Measures:
    """What was achieved, before any gate is applied."""

    episodes: list[Episode]
    wrist_m: float
    """Largest displacement of the wrist while the neighbourhood (``Contact.neighbourhood``) is touched [m]."""
    wrist_any_m: float
    """Largest displacement of the wrist over the whole trial [m]."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What was achieved, including what depends on the gates: the longest hold and the best contact episode."""

    held_steps: int
    """Longest stretch of physics steps that count toward a hold (``Behaviour.holding``)."""
    best: Episode | None
    """The episode that the score reports. For an action whose gate uses episodes, it decides whether the gate is
    met."""
    wrist_m: float
    wrist_any_m: float


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Which parts of an action's gate an attempt meets. A part that the action does not require is True."""

    time_met: bool
    """The contact lasted long enough."""
    progress_met: bool
    """The contact had the required effect, for example a displacement or a stroke."""
    band_met: bool = True
    """Force and motion were in the ranges that the gate requires: not too light, too hard or too far."""


@dataclass(frozen=True, kw_only=True)
class GatePart:
    """One of the requirements of a gate, in words, with what was reached."""

    name: str
    needed: str
    reached: str
    met: bool


@dataclass(frozen=True, kw_only=True)
class Gate:
    """The result of a trial under its gate."""

    success: bool
    time_met: bool
    progress_met: bool
    band_met: bool
    longest_on_s: float
    """Longest stretch that counts toward a hold."""
    best: Episode | None
    wrist_m: float
    wrist_any_m: float

    def time_part(self, name: str, duration_s: float, *, note: str = "") -> GatePart:
        """Return the requirement of a contact without a break; ``note`` follows what was reached."""
        return GatePart(
            name=name, needed=f"{duration_s:g} s", reached=f"{self.longest_on_s:.2f} s{note}", met=self.time_met
        )
