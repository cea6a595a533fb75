"""What policies share that press with a force: motion period by period, an arm that is soft along the tool, and the
force that encoders tell."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.policies.motion import CONTROL_HZ, NEAR_SPEED_M_S, UP, Leg, sample
from carecontact.policies.state_machine import HOVER_M

F64 = npt.NDArray[np.float64]
T = TypeVar("T")
Motion = Generator[Sequence[Action], Observation]
"""Yields chunks of actions, and takes the observation after each."""
Part = Generator[Sequence[Action], Observation, tuple[T, Observation]]
"""A part of a motion, which returns the last observation beside its result."""

FORCE_N = 3.0
"""As the oracle presses."""
STIFFNESS, ROTATIONAL = 400.0, 20.0
"""[N/m] and [N m/rad] of the impedance at rest."""
SOFT = (STIFFNESS, STIFFNESS, 0.0, ROTATIONAL, ROTATIONAL, ROTATIONAL)
DAMPING_NS_M = 2.0 * np.sqrt(STIFFNESS * 10.0)
"""Critical damping at the effective mass of 10 kg that the protocols give."""
HELD_N = 12.0
"""Force [N] beside the feedforward from which the tool counts as held or pushed. A stroke of 4 N on wet skin takes up
to 10 N, with the arm's friction and its acceleration."""
CONTACT = 3
"""Index of the leg that brings the tool down; the last two legs take it up and away (``motion.travel``)."""


def along(legs: Sequence[Leg], start_pose: F64) -> list[Action]:
    return [Action(pose_tcp_in_base=pose) for pose in sample(legs, start_pose)]


def end(leg: Leg) -> F64:
    """(7,) pose at the end of a leg."""
    return np.concatenate([leg.points[-1], leg.quat_wxyz])


def away(legs: Sequence[Leg], pose: F64, speed_m_s: float = NEAR_SPEED_M_S) -> list[Action]:
    """Return the way up from where the tool is, with the usual stiffness and no feedforward."""
    high = np.array([*pose[:2], max(float(legs[-1].points[-1][2]), float(pose[2]) + HOVER_M)])
    first, *rest = along([Leg.to(high, legs[-1].quat_wxyz, speed_m_s)], pose)
    usual = replace(first, stiffness=(STIFFNESS, ROTATIONAL), wrench_in_tcp=np.zeros(6))
    return [usual, *rest]


def ended(actions: Sequence[Action]) -> list[Action]:
    """Return actions of which the last ends the trial."""
    return [*actions[:-1], replace(actions[-1], done=True)]


def softened(action: Action, force_n: float) -> Action:
    """Return an action from which on nothing but a feedforward of ``force_n`` moves the tool along its axis."""
    return replace(action, stiffness=SOFT, wrench_in_tcp=np.array([0.0, 0.0, force_n, 0.0, 0.0, 0.0]))


def held_n(now: F64, before: F64, target: F64) -> float:
    """Return the force [N] that holds or pushes a tool, beside the feedforward with which it presses.

    Args:
        now, before: (7,) where it is, and was one control period before, in base.
        target: (7,) where the arm, soft along the tool, leads it.
    """
    out, off = -matrix_from_quat(target[3:])[:, 2], (now - target)[:3]
    rate = (now - before)[:3] * CONTROL_HZ
    return float(np.linalg.norm(STIFFNESS * (off - (off @ out) * out) + DAMPING_NS_M * rate))


class Felt:
    """The force that the person exerts on the tool, from where it is, where it should be, and its speed."""

    def __init__(self, observation: Observation, target: F64, out: F64 = UP) -> None:
        """
        Args:
            target: (7,) the last one that was sent, at which the tool rests by now.
            out: (3,) unit vector along which the force counts.
        """
        self._pose, self._out, self.target, self.zero_n = observation.pose_tcp_in_base, out, target, 0.0

    def newtons(self, observation: Observation) -> float:
        """``observation``: the one that answers the last target, one control period after the one before."""
        now = observation.pose_tcp_in_base
        rate = float((now - self._pose)[:3] @ self._out) * CONTROL_HZ
        self._pose = now
        return STIFFNESS * float((now - self.target)[:3] @ self._out) + DAMPING_NS_M * rate - self.zero_n

    def go(self, pose: F64) -> list[Action]:
        """Return the one action to a pose (7,)."""
        self.target = pose
        return [Action(pose_tcp_in_base=pose)]
