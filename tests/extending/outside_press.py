"""Press on the right hand from above, `press_mm` deeper than the skin that the camera sees."""

import numpy as np

from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

WRIST, INDEX_FINGER = 16, 20
"""Of MediaPipe Pose, on the right."""
HZ = 20.0
SOFT = (100.0, 20.0)
"""Stiffness of the arm [N/m], [N m/rad]."""


class Press:
    card = PolicyCard(name="press", modalities=("rgb", "depth", "landmarks"), control_hz=HZ)

    def __init__(self, press_mm: float, hold_s: float = 3.0) -> None:
        self.press_mm, self.hold_s = press_mm, hold_s

    def reset(self, instruction: str) -> None:
        self.instruction = instruction

    def act(self, observation):
        seen = observation.cameras["overhead"].landmarks_in_base
        hand = (seen[WRIST] + seen[INDEX_FINGER]) / 2
        pose = observation.pose_tcp_in_base
        above, pressed = hand + [0, 0, 0.15], hand - [0, 0, self.press_mm / 1000]
        legs = [(pose[:3] + [0, 0, 0.1], 1.0), (above + [0, 0, 0.1], 3.0), (above, 1.5), (pressed, 3.0)]
        way = [pose[:3]]
        for target, seconds in legs:
            way += [(1 - s) * way[-1] + s * target for s in np.linspace(0, 1, round(seconds * HZ))[1:]]
        way += [pressed] * round(self.hold_s * HZ) + [above]
        return [*(Action(pose_tcp_in_base=[*place, *pose[3:]], stiffness=SOFT) for place in way), Action(done=True)]
