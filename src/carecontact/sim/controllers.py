"""The controllers of the tool's pose and of the joints, on top of the impedance that is part of the model."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.robot import JointImpedance
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import DAMPING_RATIO
from carecontact.sim.impedance import (
    Posture,
    TargetInterpolator,
    set_gains,
    target_in_base,
    tcp_pose_in_base,
    write_target,
)
from carecontact.world.robot import AXES, add_robot, servo, tendon

F64 = npt.NDArray[np.float64]

HELD_TO = 1.1
"""The law holds the tool to this multiple of the speeds at which its target moves (chosen). With a tenth to spare, the
friction of the robot's joints does not keep the tool behind a target at full speed."""


class CartesianControl:
    """Commands the six springs of ``world.robot``; ``refresh`` is called once in every target period."""

    fastest: tuple[int, float] | None = None
    """As ``JointControl.fastest``; no joint has a limit here."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, protocol: Protocol) -> None:
        self._model, self._data, self._protocol, self._robot = model, data, protocol, protocol.scene.robot
        self._posture = Posture(model, self._robot, np.array(protocol.scene.parked_joint_rad))
        first = model.actuator("impedance_0").id
        self._rows = slice(first, first + 6)
        self._tcp = model.site(self._robot.tcp_site).id
        self._mocap = int(model.body_mocapid[model.body("tcp_target").id])
        physics = protocol.physics
        self.target = TargetInterpolator(physics)
        self._fastest = HELD_TO * physics.max_tcp_speed_m_s, HELD_TO * physics.max_tcp_rotation_rad_s
        self.feedforward: F64 = np.zeros(6)
        """(6,) force [N] and torque [N m] in the axes of the tool that are added to the springs' wrench. The clamp of
        each axis holds for the sum."""
        self._relax()

    def _relax(self) -> None:
        """Take back gains and feedforward: simulations may share a compiled scene, and another one, or an earlier trial
        of this one, may have ended with its own in force."""
        impedance, self.feedforward = self._protocol.impedance, np.zeros(6)
        self._model.actuator_biasprm[self._rows, 0] = 0.0
        stiffness = np.repeat([impedance.translational_n_m, impedance.rotational_nm_rad], 3)
        set_gains(self._model, stiffness, DAMPING_RATIO, self._protocol)
        self._damping = -self._model.actuator_biasprm[self._rows, 2]

    @property
    def target_in_base(self) -> F64:
        """(7,) where the springs' target is."""
        return self.target.pose

    def park(self) -> None:
        """Put the target on the tool, whose kinematics have to be current."""
        pose = tcp_pose_in_base(self._model, self._data, self._robot)
        self.target.reset(pose)
        write_target(self._model, self._data, self._robot, pose)

    def resume(self) -> None:
        """Continue from a restored state, with the target where this state has it."""
        self.target.reset(target_in_base(self._model, self._data, self._robot))

    def forget(self) -> None:
        """Continue from a restored state as a new controller would, without what earlier actions asked for."""
        self._relax()
        self.resume()

    def set_gains(self, stiffness: F64, damping_ratio: float = 1.0) -> None:
        """See ``impedance.set_gains``. Needs current kinematics."""
        set_gains(self._model, stiffness, damping_ratio, self._protocol)
        self._damping = -self._model.actuator_biasprm[self._rows, 2]
        self._hold_back()

    def refresh(self) -> None:
        """Advance the target by one target period, and command the posture and the feedforward for that period."""
        write_target(self._model, self._data, self._robot, self.target.advance())
        self._data.qfrc_applied[self._posture.dofs] = self._posture.torque(self._data)
        # The springs act along the target's axes; the tool's differ from them by what the tool lags behind.
        turn = matrix_from_quat(self._data.mocap_quat[self._mocap]).T @ self._data.site_xmat[self._tcp].reshape(3, 3)
        self._model.actuator_biasprm[self._rows, 0] = (self.feedforward.reshape(2, 3) @ turn.T).ravel()
        self._hold_back()

    def _hold_back(self) -> None:
        """Damp every axis at least so much that the force of springs and feedforward, before its clamp, drives the tool
        no faster than HELD_TO allows, and the torque turns it no faster. Critical damping already does this for a
        target at full speed. Therefore, this damping acts only where the tool is far from its target, where a
        feedforward has no spring, or where the policy asks for little damping (a saturation of speed, as in Khatib
        1987, IEEE J Robot Autom 3:43)."""
        data, bias = self._data, self._model.actuator_biasprm[self._rows]
        off, quat, back, target_quat = np.zeros(6), np.zeros(4), np.zeros(4), data.mocap_quat[self._mocap]
        mujoco.mju_negQuat(back, target_quat)
        mujoco.mju_rotVecQuat(off[:3], data.site_xpos[self._tcp] - data.mocap_pos[self._mocap], back)
        mujoco.mju_mat2Quat(quat, data.site_xmat[self._tcp])
        mujoco.mju_subQuat(off[3:], quat, target_quat)
        wrench = bias[:, 0] - self._model.actuator_gainprm[self._rows, 0] * off
        for part, fastest in zip((slice(3), slice(3, 6)), self._fastest, strict=True):
            bias[part, 2] = -np.maximum(self._damping[part], mujoco.mju_norm3(wrench[part]) / fastest)


class JointControl:
    """Commands the servos of ``world.robot.replace_impedance``.

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
        self.set_target(self._data.qpos[self._qpos])

    resume = park

    def forget(self) -> None:
        """As ``CartesianControl.forget``."""
        self.resume()
        self.refresh()
        self.fastest = None

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
