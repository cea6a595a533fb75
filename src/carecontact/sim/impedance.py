"""The command side of the impedance: gains, the moving target, the posture of the elbow."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import count, pairwise
from math import floor

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat, quat_from_matrix
from carecontact.interface.robot import Robot
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Physics
from carecontact.world.robot import damping_of

Array = npt.NDArray[np.float64]

POSTURE_STIFFNESS = 10.0
POSTURE_DAMPING = 3.0
"""Stiffness [N m/rad] and damping [N m s/rad] in the null space. The torque is held for a whole target period, so the
damping stays well below inertia / period (about 0.3 kg m^2 / 20 ms)."""
POSTURE_TORQUE_NM = 10.0
"""Largest norm of the posture torque before projection."""
RIDGE = 1e-6 * np.eye(6)


def set_gains(model: mujoco.MjModel, stiffness: Array, damping_ratio: float, protocol: Protocol) -> None:
    """Edit the impedance's gains in place.

    Args:
        stiffness: (6,) x y z [N/m], then about x y z [N m/rad]. The bounds have been checked. An axis without any is
            damped as if it had the smallest that the protocol allows, since a feedforward alone moves it.
        damping_ratio: share of critical damping at the protocol's effective mass and inertia.
    """
    impedance = protocol.impedance
    linear = impedance.translational_bounds[0], impedance.effective_mass_kg
    angular = impedance.rotational_bounds[0], impedance.effective_inertia_kgm2
    for axis, value in enumerate(np.asarray(stiffness, np.float64).tolist()):
        least, inertia = linear if axis < 3 else angular
        row = model.actuator(f"impedance_{axis}").id
        model.actuator_gainprm[row, 0] = value
        model.actuator_biasprm[row, 1:3] = [-value, -damping_ratio * damping_of(value or least, inertia)]


def write_target(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, pose_in_base: Array) -> None:
    """Put the mocap target at a TCP pose (7,) in the robot's base frame."""
    base = model.body(robot.base_body).id
    mocap = int(model.body_mocapid[model.body("tcp_target").id])
    origin, turn = model.body_pos[base], model.body_quat[base]
    mujoco.mju_mulPose(data.mocap_pos[mocap], data.mocap_quat[mocap], origin, turn, pose_in_base[:3], pose_in_base[3:])


def target_in_base(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> Array:
    """(7,) where the mocap target is; the inverse of ``write_target``."""
    base = model.body(robot.base_body).id
    mocap = int(model.body_mocapid[model.body("tcp_target").id])
    rotation = matrix_from_quat(model.body_quat[base])
    inverse, quat = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, model.body_quat[base])
    mujoco.mju_mulQuat(quat, inverse, data.mocap_quat[mocap])
    return np.concatenate([rotation.T @ (data.mocap_pos[mocap] - model.body_pos[base]), quat])


def tcp_pose_in_base(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> Array:
    """(7,) position [m], quat_wxyz with w >= 0. Needs current kinematics (after mj_forward or mj_step)."""
    base = model.body(robot.base_body).id
    rotation = matrix_from_quat(model.body_quat[base])
    site = data.site(robot.tcp_site)
    position = rotation.T @ (site.xpos - model.body_pos[base])
    return np.concatenate([position, quat_from_matrix(rotation.T @ site.xmat.reshape(3, 3))])


class TargetInterpolator:
    """Moves the impedance's target toward the policy's last target, a little every target period.

    The way from where the target is to the goal takes the policy's period, or longer if the speed limits require it;
    position and rotation then arrive together.
    """

    def __init__(self, physics: Physics) -> None:
        self._step_s = physics.target_period_s
        self._speed_m_s, self._speed_rad_s = physics.max_tcp_speed_m_s, physics.max_tcp_rotation_rad_s
        self.reset(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))

    @property
    def pose(self) -> Array:
        """(7,) current target pose in base."""
        return self._pose.copy()

    def reset(self, pose_in_base: Array) -> None:
        """Jump to a pose (7,) and stay there."""
        self._pose = _unit_pose(pose_in_base)
        self._start = self._goal = self._pose
        self._duration_s, self._elapsed_s = self._step_s, 0.0

    def set_goal(self, pose_in_base: Array | None, period_s: float) -> None:
        """Move toward a new pose (7,), or on to the last one for None. ``period_s``: of the policy's actions."""
        if pose_in_base is None:
            return
        self._start, self._goal, self._elapsed_s = self._pose, _unit_pose(pose_in_base), 0.0
        distance = float(np.linalg.norm(self._goal[:3] - self._start[:3]))
        angle = _angle(self._start[3:], self._goal[3:])
        self._duration_s = max(period_s, distance / self._speed_m_s, angle / self._speed_rad_s)

    def advance(self) -> Array:
        """The target pose in base (7,) for the next target period."""
        self._elapsed_s += self._step_s
        # The tolerance lets a way of exactly n periods end in n, not n + 1.
        share = self._elapsed_s / self._duration_s
        if share > 1.0 - 1e-9:
            self._pose = self._goal
        else:
            position = self._start[:3] + share * (self._goal[:3] - self._start[:3])
            self._pose = np.concatenate([position, slerp(self._start[3:], self._goal[3:], share)])
        return self._pose.copy()


def _unit_pose(pose: Array) -> Array:
    pose = np.array(pose, np.float64)
    pose[3:] /= np.linalg.norm(pose[3:])
    return pose


def _angle(a: Array, b: Array) -> float:
    """Rotation angle [rad] between two unit quaternions, in [0, pi]."""
    sign = 1.0 if a @ b >= 0 else -1.0
    return 4.0 * float(np.arctan2(np.linalg.norm(a - sign * b), np.linalg.norm(a + sign * b)))


def slerp(a: Array, b: Array, share: float) -> Array:
    """Unit quaternion at ``share`` of the short way from ``a`` to ``b``."""
    if a @ b < 0:
        b = -b
    half = _angle(a, b) / 2
    if half < 1e-8:
        return b.copy()
    q = (np.sin((1 - share) * half) * a + np.sin(share * half) * b) / np.sin(half)
    return q / np.linalg.norm(q)


def steps_of_period(rate_hz: float, dt_s: float) -> Iterator[int]:
    """Physics steps of each control period, without end, such that the mean rate is exact (15 Hz at 2 ms: 33, 33, 34).

    Raises ValueError if the rate is faster than the physics.
    """
    period = 1 / (Fraction(rate_hz).limit_denominator(10_000) * Fraction(dt_s).limit_denominator(1_000_000))
    if period < 1:
        raise ValueError(f"rate_hz {rate_hz} is faster than the physics step {dt_s} s")
    return (end - start for start, end in pairwise(floor(k * period) for k in count()))


class Posture:
    """Pulls the robot's arm toward a posture in the null space, without accelerating the TCP."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, posture: Array) -> None:
        """``posture``: (joints,) [rad]."""
        first, count = model.joint(robot.joints[0]), len(robot.joints)
        self._model, self._posture = model, posture
        self.dofs = slice(int(first.dofadr[0]), int(first.dofadr[0]) + count)
        """Of the robot's joints."""
        self._joints = slice(int(first.qposadr[0]), int(first.qposadr[0]) + count)
        self._tcp = model.site(robot.tcp_site).id
        self._jacobian, self._mobility = np.zeros((6, model.nv)), np.zeros((6, model.nv))
        self._wrench = np.zeros(6)

    def torque(self, data: mujoco.MjData) -> Array:
        """(joints,) joint torque.

        The projection is dynamically consistent (Khatib 1987): 1 - J^T (J M^-1 J^T)^-1 J M^-1. Evaluate once a target
        period and write it to ``qfrc_applied`` at ``dofs``. Needs a current mass matrix (after mj_forward).
        """
        off = self._posture - data.qpos[self._joints]
        torque = POSTURE_STIFFNESS * off - POSTURE_DAMPING * data.qvel[self.dofs]
        torque *= min(1.0, POSTURE_TORQUE_NM / max(mujoco.mju_norm(torque), 1e-9))
        mujoco.mj_jacSite(self._model, data, self._jacobian[:3], self._jacobian[3:], self._tcp)
        mujoco.mj_solveM(self._model, data, self._mobility, self._jacobian)
        jacobian, mobility = self._jacobian[:, self.dofs], self._mobility[:, self.dofs]
        # The ridge keeps a singular posture finite; it leaves 1e-6 of the torque unprojected elsewhere.
        factor = jacobian @ mobility.T + RIDGE
        mujoco.mju_cholFactor(factor, 0.0)
        mujoco.mju_cholSolve(self._wrench, factor, mobility @ torque)
        return torque - jacobian.T @ self._wrench
