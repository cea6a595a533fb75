"""How the action space of ``outside_step`` becomes a joint target."""

from __future__ import annotations

import numpy as np

from carecontact.episode.drivers import JointDriver


class JointStep(JointDriver):
    def _target(self, joint: np.ndarray) -> np.ndarray:
        if not hasattr(self, "_last"):
            self._last = self.simulation.encoders.joint_position(self.simulation.data)
        self._last = self._last + joint
        return self._last
