"""Touch and scrub as the oracle does them: the state machine's way, carried along by the skin, pressed to a force."""

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
"""A light, clear press: the middle, as a ratio, of the 1 to 8 N in which people wash (design of gates-v2)."""
LEAST_N = 1.5
"""With less, the way along the skin waits until the press is back."""
MOST_N = 5.0
"""With more, a touch is not steady."""
STEADY_S = 1.3
"""A touch rests until it was steady for so long without interruption; 1 s is asked for."""
PATIENCE_S = 5.0
"""How long it waits in all; then it goes on as it is."""
GAIN_M_NS = 0.006
"""Change of depth per second and newton. With 400 N/m and soft tissue, 1 N is about 3.5 mm: the loop closes in 0.6 s,
twice the time that the impedance lags behind its target."""
DEEPEST_M = 0.06
"""At most 24 N at 400 N/m, whatever the force is believed to be."""
MOST_LEAD_M = 0.008
"""Of a target ahead of a tool that rubs: the friction of 3 N on a dry belly, at 400 N/m."""
SMOOTHING = 0.3
"""Share of the newest value in the running mean of that friction."""
FIRST_IN_CONTACT = 3
"""Number of the leg that comes down; the two before the last go up and away."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One control period of a plan."""

    pose: F64
    """(7,) in base where the person lay when it was planned."""
    presses: bool


def stages(legs: Sequence[Leg], start_pose: F64) -> list[Stage]:
    """The whole way of a touch or a scrub; it presses from where it has come down until it goes up."""
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
    """Gives one target after another; ``ended`` after the last."""

    def __init__(self, truth: Truth, plan: Sequence[Stage], *, rests: bool) -> None:
        """``rests``: whether the tool stays where it came down until the force was steady."""
        self._truth, self._plan, self._follower = truth, plan, Follower(truth)
        self._rests_until = max(k for k, stage in enumerate(plan) if stage.presses) if rests else -1
        self._at, self._depth_m, self._waited = 0, 0.0, 0
        self._steady = self._longest = 0
        self._lead_m = np.zeros(3)

    @property
    def succeeded(self) -> bool:
        """Whether the skin was always there to press on within its patience."""
        return self._waited < PATIENCE_S * CONTROL_HZ

    @property
    def ended(self) -> bool:
        return self._at >= len(self._plan)

    def act(self) -> Action:
        """The target for the next control period."""
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
        """(3,) level way from the target by which friction keeps the tool back [m]."""
        wanted = self._truth.force() * [1, 1, 0] / self._truth.simulation.protocol.impedance.translational_n_m
        wanted *= min(1.0, MOST_LEAD_M / max(float(np.linalg.norm(wanted)), 1e-9))
        self._lead_m += SMOOTHING * (wanted - self._lead_m)
        return self._lead_m
