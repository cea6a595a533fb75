"""The Cartesian impedance of a running world: its gains, its moving target, its feedforward and the elbow's posture."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import PANDA
from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.protocol import Protocol
from carecontact.sim.impedance import (
    Posture,
    TargetInterpolator,
    set_gains,
    target_in_base,
    tcp_pose_in_base,
    write_target,
)

F64 = npt.NDArray[np.float64]


class CartesianControl:
    """Commands the six springs of ``world.robot``; ``refresh`` is called once in every target period."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, protocol: Protocol) -> None:
        self._model, self._data, self._protocol = model, data, protocol
        self._posture = Posture(model, np.array(protocol.scene.parked_joint_rad))
        self._rows = np.array([model.actuator(f"impedance_{axis}").id for axis in range(6)])
        self._tcp = model.site(PANDA.tcp_site).id
        self._mocap = int(model.body_mocapid[model.body("tcp_target").id])
        self._interpolator = TargetInterpolator(protocol.physics)
        self.feedforward: F64 = np.zeros(6)
        """(6,) force [N] and torque [N m] in the axes of the tool that are added to the springs' wrench. The clamp of
        each axis holds for the sum."""
        # Simulations may share a compiled scene, and another one may have ended with its feedforward in force.
        model.actuator_biasprm[self._rows, 0] = 0.0
        impedance = protocol.impedance
        self.set_gains(np.repeat([impedance.translational_n_m, impedance.rotational_nm_rad], 3))

    @property
    def target_in_base(self) -> F64:
        """(7,) where the springs' target is."""
        return self._interpolator.pose

    def park(self) -> None:
        """Put the target on the tool, whose kinematics have to be current."""
        pose = tcp_pose_in_base(self._model, self._data)
        self._interpolator.reset(pose)
        write_target(self._model, self._data, pose)

    def resume(self) -> None:
        """Continue from a restored state, with the target where this state has it."""
        self._interpolator.reset(target_in_base(self._model, self._data))

    def set_goal(self, pose_in_base: F64 | None, period_s: float) -> None:
        """See ``TargetInterpolator.set_goal``."""
        self._interpolator.set_goal(pose_in_base, period_s)

    def set_gains(self, stiffness: F64, damping_ratio: float = 1.0) -> None:
        """See ``impedance.set_gains``."""
        set_gains(self._model, stiffness, damping_ratio, self._protocol)

    def refresh(self) -> None:
        """Advance the target by one target period, and command the posture and the feedforward for that period."""
        write_target(self._model, self._data, self._interpolator.advance())
        self._data.qfrc_applied[self._posture.dofs] = self._posture.torque(self._data)
        # The springs act along the target's axes; the tool's differ from them by what the tool lags behind.
        turn = matrix_from_quat(self._data.mocap_quat[self._mocap]).T @ self._data.site_xmat[self._tcp].reshape(3, 3)
        self._model.actuator_biasprm[self._rows, 0] = (self.feedforward.reshape(2, 3) @ turn.T).ravel()
