"""The joint impedance of a running world: its target and what it needs once in every target period."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.control import JointImpedance
from carecontact.contract.protocol import Protocol
from carecontact.sim.impedance import tcp_pose_in_base
from carecontact.world.joint_impedance import AXES, servo, tendon
from carecontact.world.robot import add_robot

F64 = npt.NDArray[np.float64]


class JointControl:
    """Commands the servos of ``world.joint_impedance``.

    Between two refreshes MuJoCo evaluates the law by itself, with the Jacobian and the Coriolis torque of the last
    refresh and with the angles and velocities of each physics step.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, protocol: Protocol, law: JointImpedance) -> None:
        self._model, self._data, self._robot = model, data, protocol.scene.robot
        joints = [model.joint(name) for name in self._robot.joints]
        self._qpos, self._dof = (np.array([getattr(j, at)[0] for j in joints]) for at in ("qposadr", "dofadr"))
        self._servos = np.array([model.actuator(servo(number)).id for number in range(len(joints))])
        self._tendons = np.array([model.actuator(tendon(axis)).id for axis in range(AXES)])
        first = np.array([model.tendon_adr[model.tendon(tendon(axis)).id] for axis in range(AXES)])
        self._coefficients = first[:, None] + np.arange(len(joints))
        self._arm = _arm_alone(protocol)
        self._now, self._then = mujoco.MjData(self._arm), mujoco.MjData(self._arm)
        self._flange = self._arm.body(self._robot.flange_body).id
        self._limit_rad_s = np.array(law.velocity_limit_rad_s)
        self._target = np.zeros(len(joints))
        self.fastest: tuple[int, float] | None = None
        """Number from 1 and speed [rad/s] of a joint that was beyond its limit at a refresh; None while none was."""

    @property
    def joint_position(self) -> F64:
        """(joints,) measured [rad]"""
        return self._data.qpos[self._qpos].copy()

    @property
    def target_in_base(self) -> F64:
        """(7,) pose that the tool would have at the target angles."""
        self._then.qpos[:] = self._target
        mujoco.mj_kinematics(self._arm, self._then)
        return tcp_pose_in_base(self._arm, self._then, self._robot)

    def set_target(self, joint_position: F64) -> None:
        """``joint_position``: (joints,) [rad]; it holds from the next refresh on."""
        self._target = np.array(joint_position, np.float64)

    def park(self) -> None:
        """Make the angles that the joints have now the target."""
        self.set_target(self.joint_position)

    resume = park

    def refresh(self) -> None:
        """Write target, Jacobian and Coriolis torque of this moment into the model and its controls."""
        arm, now = self._arm, self._now
        now.qpos[:], now.qvel[:] = self._data.qpos[self._qpos], self._data.qvel[self._dof]
        too_fast = np.abs(now.qvel) > self._limit_rad_s
        if too_fast.any() and self.fastest is None:
            joint = int(np.argmax(np.abs(now.qvel) / self._limit_rad_s))
            self.fastest = joint + 1, float(abs(now.qvel[joint]))
        mujoco.mj_kinematics(arm, now)
        mujoco.mj_comPos(arm, now)
        mujoco.mj_comVel(arm, now)
        jacobian, coriolis = np.zeros((AXES, arm.nv)), np.zeros(arm.nv)
        mujoco.mj_jacBody(arm, now, jacobian[:3], jacobian[3:], self._flange)
        mujoco.mj_rne(arm, now, 0, coriolis)
        self._model.wrap_prm[self._coefficients] = jacobian
        self._data.ctrl[self._servos], self._data.ctrl[self._tendons] = self._target, jacobian @ self._target
        self._data.qfrc_applied[self._dof] = coriolis


def _arm_alone(protocol: Protocol) -> mujoco.MjModel:
    """The arm without gravity and without the person: what a robot's own controller knows."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = np.zeros(3)
    add_robot(spec, protocol)
    return spec.compile()
