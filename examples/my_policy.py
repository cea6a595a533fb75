"""Your own policy: `carecontact run --policy my_policy:MyPolicy` from this folder."""

import numpy as np

from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard


class MyPolicy:
    card = PolicyCard(name="lift-50-mm", modalities=("rgb", "landmarks"), cameras=("overhead",), control_hz=10)

    def reset(self, instruction):
        self.instruction = instruction

    def act(self, observation):
        """Raise the tool 50 mm over one second, then end the trial."""
        poses = np.tile(observation.pose_tcp_in_base, (10, 1))
        poses[:, 2] += np.linspace(0.005, 0.05, 10)
        return [*(Action(pose_tcp_in_base=pose) for pose in poses), Action(done=True)]
