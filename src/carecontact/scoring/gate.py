"""What a trial achieved in the quantities of the gates, and the verdict on it."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.scoring.progress import Episode


@dataclass(frozen=True, kw_only=True)
class Measures:
    """What was achieved, before any gate is applied."""

    episodes: list[Episode]
    wrist_m: float
    """Largest displacement of the wrist while the neighbourhood is on."""
    wrist_any_m: float
    """The same over the whole trial."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What was achieved, with what depends on the gates: what counts as a hold, and which episode is best."""

    held_steps: int
    """Longest stretch of physics steps that count toward a hold (``Behaviour.holding``)."""
    best: Episode | None
    """The episode that is reported, and on which an action that looks at episodes is judged."""
    wrist_m: float
    wrist_any_m: float


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What an action's gate says of an attempt. Each part that the action does not require is True."""

    time_met: bool
    """The contact lasted long enough."""
    progress_met: bool
    """What the contact had to bring about was reached: a displacement, a stroke."""
    band_met: bool = True
    """Nothing was too light, too hard or too far: contact and motion were in the ranges that the gate asks for."""


@dataclass(frozen=True, kw_only=True)
class Gate:
    """The judged trial."""

    success: bool
    time_met: bool
    progress_met: bool
    band_met: bool
    longest_on_s: float
    """Longest stretch that counts toward a hold."""
    best: Episode | None
    wrist_m: float
    wrist_any_m: float
