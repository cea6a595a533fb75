"""How an episode ends, and the forces at which the benchmark stops it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol
from carecontact.recording.schema import SEGMENTS, EndReason, Failure


@dataclass(frozen=True, kw_only=True)
class Ended:
    reason: EndReason
    failure: Failure | None = None
    """What went wrong, where something did."""


class ForceCut:
    """Ends a trial once any segment bears more than the protocol's multiple of its pain limit."""

    def __init__(self, protocol: Protocol) -> None:
        self._limit_n = np.array([protocol.phases.truncation_over_pain * protocol.f_pain(s) for s in SEGMENTS])

    def cut(self, force_n: npt.NDArray[np.float64]) -> Ended | None:
        """``force_n``: (n, S) norms; None while every one of them is allowed."""
        over = force_n > self._limit_n
        if not over.any():
            return None
        step, segment = np.argwhere(over)[0]
        message = f"{force_n[step, segment]:.0f} N on {SEGMENTS[segment]}, cut at {self._limit_n[segment]:.0f} N"
        return Ended(reason="safety_truncation", failure=Failure(kind="force", message=message))


def cut_by_solver(warnings: list[str]) -> Ended | None:
    """None without warnings. What a period that diverged left in the sensors is not a measurement."""
    if not warnings:
        return None
    failure = Failure(kind="solver", message=f"MuJoCo warning {', '.join(warnings)}")
    return Ended(reason="safety_truncation", failure=failure)


def cut_by_speed(fastest: tuple[int, float] | None) -> Ended | None:
    """Return how the trial ends where a robot would have stopped; None while no joint was too fast.

    Args:
        fastest: number of the joint and its speed [rad/s].
    """
    if fastest is None:
        return None
    message = f"joint {fastest[0]} moved at {fastest[1]:.2f} rad/s, faster than the robot's controller allows"
    return Ended(reason="safety_truncation", failure=Failure(kind="joint_speed", message=message))
