from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carecontact.oracle.push import MOST_WRIST_M, PUSHES, Push
from carecontact.policies.motion import Leg
from carecontact.protocols import load_protocol

QUAT = np.array([0.0, 1.0, 0.0, 0.0])
START = np.array([0.4, 0.0, 0.4, *QUAT])
LOW = np.array([0.5, 0.0, 0.3])


class Limb:
    """A limb that the tool finds at once, and whose wrist the person takes along."""

    def __init__(self, speed_m_s: float) -> None:
        self.simulation = SimpleNamespace(protocol=load_protocol())
        self.at, self.step = np.zeros(3), np.array([speed_m_s / 20, 0.0, 0.0])

    def frame(self) -> np.ndarray:
        return np.eye(4)

    def force_n(self) -> float:
        return 3.5

    def wrist(self) -> np.ndarray:
        self.at = self.at + self.step
        return self.at


@pytest.mark.parametrize(("speed_m_s", "lets_go"), [(0.06, True), (0.0, False)])
def test_a_push_lets_go_before_person_and_tool_together_move_the_wrist_too_far(speed_m_s: float, lets_go: bool) -> None:
    legs = [Leg(points=LOW[None], quat_wxyz=QUAT, speed_m_s=0.1)] * (PUSHES + 3)
    legs[PUSHES] = Leg(points=LOW[None] + [0.05, 0.0, 0.0], quat_wxyz=QUAT, speed_m_s=0.1)
    legs[-1] = Leg(points=LOW[None] + [0.0, 0.0, 0.1], quat_wxyz=QUAT, speed_m_s=0.1)
    limb: Any = Limb(speed_m_s)
    push, farthest = Push(limb, legs, START), 0.0
    while not push.ended:
        pose = push.act().pose_tcp_in_base
        assert pose is not None
        farthest = max(farthest, float(pose[0] - LOW[0]))
    assert not push.succeeded
    assert (farthest < MOST_WRIST_M + 0.01) is lets_go
