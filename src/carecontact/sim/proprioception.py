"""What a real robot knows about itself: its joint angles and, computed from them, the pose of its tool."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import PANDA

F64 = npt.NDArray[np.float64]


class Proprioception:
    """Reads joint encoders and poses in the base frame. No torque, no force."""

    def __init__(self, model: mujoco.MjModel) -> None:
        joints = [model.joint(name) for name in PANDA.joints]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._base = model.body(PANDA.base_body).id
        self._tcp = model.site(PANDA.tcp_site).id

    def joint_position(self, data: mujoco.MjData) -> F64:
        """(7,) [rad]"""
        return data.qpos[self._qpos].copy()

    def joint_velocity(self, data: mujoco.MjData) -> F64:
        """(7,) [rad/s]"""
        return data.qvel[self._dof].copy()

    def set_joint_position(self, data: mujoco.MjData, joint_position: npt.ArrayLike) -> None:
        """Set the robot's joints (7,) [rad], in a copy of the state that shows the robot alone. Raises ValueError for
        another shape."""
        angles = np.asarray(joint_position, np.float64)
        if angles.shape != (len(PANDA.joints),):
            raise ValueError(f"joint_position: expected 7 angles [rad], got shape {angles.shape}")
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
