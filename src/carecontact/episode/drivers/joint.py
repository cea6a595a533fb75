"""Targets of the robot's joints, absolute or as DROID's normalised velocities."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.episode.drivers.driver import Driver

F64 = npt.NDArray[np.float64]

DROID_STEP_RAD = 0.2
"""Change of the target [rad] in one control period at a normalised velocity of 1 (``relative_max_joint_delta`` in
DROID's droid/robot_ik/robot_ik_solver.py)."""


class JointDriver(Driver):
    """Turns the numbers of an action into a joint target that holds until the next action."""

    def apply(self, action: Action, period_s: float) -> Mapping[str, F64]:
        if action.joint is not None:
            self.simulation.set_joint_target(self._target(action.joint))
        joints = len(self.simulation.robot.joints)
        return {
            "actions/pose_tcp_in_base": np.full(7, np.nan),
            "actions/stiffness": np.full(2, np.nan),
            "actions/joint": np.full(joints, np.nan) if action.joint is None else action.joint,
        }

    @abstractmethod
    def _target(self, joint: F64) -> F64:
        """Turn the numbers (joints,) of an action into joint targets (joints,) [rad]."""


class JointPosition(JointDriver):
    def _target(self, joint: F64) -> F64:
        return joint


class DroidJointVelocity(JointDriver):
    """Adds each velocity to the measured angles and not to the last target, so that the target does not run away while
    the robot pushes.
    """

    def _target(self, joint: F64) -> F64:
        return self.simulation.encoders.joint_position(self.simulation.data) + DROID_STEP_RAD * joint / max(
            1.0, float(np.abs(joint).max())
        )
