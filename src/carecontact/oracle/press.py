"""How the oracle touches and scrubs: on the state machine's path, which moves with the skin, at a chosen force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.oracle.follow import Follower
from carecontact.oracle.truth import Truth
from carecontact.policies.motion import CONTROL_HZ, UP, Leg, sample

F64 = npt.NDArray[np.float64]

FORCE_N = 3.0
"""A light, clear press: the middle, as a ratio, of the 1 to 8 N in which people wash (design of the exam's gates)."""
LEAST_N = 1.5
"""Below this force [N], the tool stops along the skin until it presses again."""
MOST_N = 5.0
"""Above this force [N], a touch does not count as steady."""
STEADY_S = 1.3
"""A touch lasts until it was steady for this time [s] without interruption; the gate asks for 1 s."""
PATIENCE_S = 5.0
"""Longest time [s] that it waits for a steady touch; then it goes on without one."""
GAIN_M_NS = 0.006
"""Rate of change of the depth [m/s] for each newton that the force is off. At 400 N/m on soft tissue, 1 N is about
3.5 mm, so that the loop has a time constant of 0.6 s, twice the lag of the impedance behind its target."""
DEEPEST_M = 0.06
"""Largest depth [m] of the target. At 400 N/m it limits the force to 24 N, whatever force was measured."""
MOST_LEAD_M = 0.008
"""Largest lead [m] of the target over a tool that rubs: at 400 N/m, what the friction of a 3 N press on dry skin
takes."""
SMOOTHING = 0.3
"""Share of the newest value in the exponential running mean of that lead."""
FIRST_IN_CONTACT = 3
"""Index of the leg that brings the tool down; the two legs before the last one take it up and away."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One control period of a plan."""

    pose: F64
    """(7,) target pose in the robot's base, for where the person lay at the time of planning."""
    presses: bool


def stages(legs: Sequence[Leg], start_pose: F64) -> list[Stage]:
    """Return all control periods of a touch or a scrub. The tool presses between coming down and going up."""
    out: list[Stage] = []
    at = start_pose
    for number, leg in enumerate(legs):
        poses = list(sample([leg], at, control_hz=CONTROL_HZ))
        held = len(poses) - round(leg.hold_s * CONTROL_HZ)
        along = FIRST_IN_CONTACT < number < len(legs) - 2
        out += [
            Stage(pose=pose, presses=along or (number == FIRST_IN_CONTACT and k >= held))
            for k, pose in enumerate(poses)
        ]
        at = np.concatenate([leg.points[-1], leg.quat_wxyz])
    return out


class Press:
    """Gives one target for each control period; ``ended`` is true after the last one."""

    def __init__(self, truth: Truth, plan: Sequence[Stage], *, rests: bool) -> None:
        """``rests``: whether the tool stays where it came down until the force has been steady."""
        self._truth, self._plan, self._follower = truth, plan, Follower(truth)
        self._rests_until = max(k for k, stage in enumerate(plan) if stage.presses) if rests else -1
        self._at, self._depth_m, self._waited = 0, 0.0, 0
        self._steady = self._longest = 0
        self._lead_m = np.zeros(3)

    @property
    def succeeded(self) -> bool:
        """Whether all waits for the skin together stayed below PATIENCE_S."""
        return self._waited < PATIENCE_S * CONTROL_HZ

    @property
    def ended(self) -> bool:
        return self._at >= len(self._plan)

    def act(self) -> Action:
        """Return the target for the next control period."""
        stage, force = self._plan[self._at], self._truth.force_n()
        place = self._follower.follow(stage.pose[:3])
        waits = False
        if stage.presses:
            change = GAIN_M_NS * (FORCE_N - force) / CONTROL_HZ
            self._depth_m = float(np.clip(self._depth_m + change, 0.0, DEEPEST_M))
            place = place - self._depth_m * UP + self._ahead()
            self._steady = self._steady + 1 if LEAST_N <= force <= MOST_N else 0
            self._longest = max(self._longest, self._steady)
            rests = self._at == self._rests_until and self._longest < STEADY_S * CONTROL_HZ
            waits = (force < LEAST_N or rests) and self._waited < PATIENCE_S * CONTROL_HZ
        self._waited += waits
        self._at += not waits
        return Action(pose_tcp_in_base=np.concatenate([place, stage.pose[3:]]))

    def _ahead(self) -> F64:
        """Return the horizontal vector (3,) [m] by which friction holds the tool back from its target."""
        wanted = self._truth.force() * [1, 1, 0] / self._truth.simulation.protocol.impedance.translational_n_m
        wanted *= min(1.0, MOST_LEAD_M / max(float(np.linalg.norm(wanted)), 1e-9))
        self._lead_m += SMOOTHING * (wanted - self._lead_m)
        return self._lead_m
