"""What a real robot knows about itself: its joint angles and, computed from them, the pose of its tool."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import Robot

F64 = npt.NDArray[np.float64]


class Proprioception:
    """Reads joint encoders and poses in the base frame. No torque, no force."""

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        joints = [model.joint(name) for name in robot.joints]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._base = model.body(robot.base_body).id
        self._tcp = model.site(robot.tcp_site).id

    def joint_position(self, data: mujoco.MjData) -> F64:
        """(joints,) [rad]"""
        return data.qpos[self._qpos].copy()

    def joint_velocity(self, data: mujoco.MjData) -> F64:
        """(joints,) [rad/s]"""
        return data.qvel[self._dof].copy()

    def set_joint_position(self, data: mujoco.MjData, joint_position: npt.ArrayLike) -> None:
        """Set the robot's joints [rad] in a copy of the state that shows the robot alone. Raises ValueError for another
        shape than (joints,)."""
        angles = np.asarray(joint_position, np.float64)
        if angles.shape != self._qpos.shape:
            raise ValueError(f"joint_position: expected {len(self._qpos)} angles [rad], got shape {angles.shape}")
        data.qpos[self._qpos] = angles

    def in_base(self, data: mujoco.MjData, position: npt.ArrayLike, rotation: npt.ArrayLike) -> F64:
        """World position (3,) and matrix (3, 3) or (9,) -> (4, 4) pose in base."""
        base = data.xmat[self._base].reshape(3, 3)
        pose = np.eye(4)
        pose[:3, :3] = base.T @ np.reshape(rotation, (3, 3))
        pose[:3, 3] = base.T @ (np.asarray(position) - data.xpos[self._base])
        return pose

    def pose_tcp_in_base(self, data: mujoco.MjData) -> F64:
        """(4, 4), z out of the tool."""
        return self.in_base(data, data.site_xpos[self._tcp], data.site_xmat[self._tcp])
