"""How an episode ends, and the forces at which the benchmark stops it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol
from carecontact.recording.schema import SEGMENTS, EndReason, Failure

STOPPED_OVER = 1.6
"""The robot stops itself above this multiple of the speed at which its target moves: 0.4 m/s where that is 0.25 m/s
(chosen). The impedance holds the tool to 1.1 times that speed, and a torque about the tool or what it touches adds to
that. With the declared 10 kg, 0.4 m/s are 0.8 J; a ball goes through the skin of a heavy abdomen from 0.91 J on."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    reason: EndReason
    failure: Failure | None = None
    """What went wrong; None where nothing did."""


class ForceCut:
    """Ends a trial as soon as any segment bears more than the protocol's multiple of its pain limit."""

    def __init__(self, protocol: Protocol) -> None:
        self._limit_n = np.array([protocol.phases.truncation_over_pain * protocol.f_pain(s) for s in SEGMENTS])

    def cut(self, force_n: npt.NDArray[np.float64]) -> Ended | None:
        """Return how the trial ends, or None while every force is allowed.

        ``force_n``: (n, S) magnitudes [N] of the forces on S segments in n steps.
        """
        over = force_n > self._limit_n
        if not over.any():
            return None
        step, segment = np.argwhere(over)[0]
        message = f"{force_n[step, segment]:.0f} N on {SEGMENTS[segment]}, cut at {self._limit_n[segment]:.0f} N"
        return Ended(reason="safety_truncation", failure=Failure(kind="force", message=message))


def cut_by_solver(warnings: list[str]) -> Ended | None:
    """Return how a trial with warnings of the solver ends; None without warnings.

    The sensor values of a period that diverged are no measurement.
    """
    if not warnings:
        return None
    failure = Failure(kind="solver", message=f"MuJoCo warning {', '.join(warnings)}")
    return Ended(reason="safety_truncation", failure=failure)


def cut_by_tool(speed_m_s: npt.NDArray[np.float64], protocol: Protocol) -> Ended | None:
    """Return how a trial ends in which a real robot would have stopped itself; None while the tool was slow enough.

    No period is recorded in which the tool was faster: a real robot stops at that moment (libfranka calls this
    ``cartesian_velocity_violation``), and what the tool does after it would be no measurement.

    Args:
        speed_m_s: (n,) of the tool in n steps.
    """
    limit, fastest = STOPPED_OVER * protocol.physics.max_tcp_speed_m_s, float(speed_m_s.max())
    if fastest <= limit:
        return None
    message = f"the tool moved at {fastest:.2f} m/s, and the robot stops itself above {limit:.2f} m/s"
    return Ended(reason="safety_truncation", failure=Failure(kind="tool_speed", message=message))


def cut_by_speed(fastest: tuple[int, float] | None) -> Ended | None:
    """Return how a trial ends in which a real robot would have stopped itself; None while no joint was too fast.

    Args:
        fastest: number of the fastest joint and its speed [rad/s]; None if no joint exceeded its limit.
    """
    if fastest is None:
        return None
    message = f"joint {fastest[0]} moved at {fastest[1]:.2f} rad/s, faster than the robot's controller allows"
    return Ended(reason="safety_truncation", failure=Failure(kind="joint_speed", message=message))
