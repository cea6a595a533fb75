"""What a simulation's state contains directly: the robot's encoders and tool pose, and the place of the skin."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.interface.robot import Robot

F64 = npt.NDArray[np.float64]


class Proprioception:
    """Reads what a real robot knows about itself: joint encoders and poses in the base frame; no torque, no force."""

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        joints = [model.joint(name) for name in robot.joints]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._base = model.body(robot.base_body).id
        self._tcp = model.site(robot.tcp_site).id
        self._model = model

    def joint_position(self, data: mujoco.MjData) -> F64:
        """(joints,) [rad]"""
        return data.qpos[self._qpos].copy()

    def joint_velocity(self, data: mujoco.MjData) -> F64:
        """(joints,) [rad/s]"""
        return data.qvel[self._dof].copy()

    def velocity_tcp_in_base(self, data: mujoco.MjData, joint_velocity: F64) -> F64:
        """(6,) velocity of the tool centre point [m/s] and angular velocity of the tool [rad/s] in base, for joint
        velocities (joints,) [rad/s] at the angles of ``data``, whose kinematics are current."""
        jacobian = np.zeros((6, self._model.nv))
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_jacSite(self._model, data, jacobian[:3], jacobian[3:], self._tcp)
        base = data.xmat[self._base].reshape(3, 3)
        return ((jacobian[:, self._dof] @ joint_velocity).reshape(2, 3) @ base).ravel()

    def set_joint_position(self, data: mujoco.MjData, joint_position: npt.ArrayLike) -> None:
        """Set the robot's joints (joints,) [rad]. Raises ValueError for another shape."""
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


ALL_SIDES = 0b11110000
"""Four truths as ``np.packbits`` packs them."""


def skin_in_world(model: mujoco.MjModel, data: mujoco.MjData) -> F64:
    """(V, 3) vertices of the only skin, moved by its bones as MuJoCo draws it, without its inflation [m]."""
    vertices = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)
    placed = np.zeros_like(vertices)
    bind = np.zeros(9)
    for bone in range(model.nskinbone):
        start, count = int(model.skin_bonevertadr[bone]), int(model.skin_bonevertnum[bone])
        ids = model.skin_bonevertid[start : start + count]
        weight = np.asarray(model.skin_bonevertweight[start : start + count], np.float64)[:, None]
        body = int(model.skin_bonebodyid[bone])
        mujoco.mju_quat2Mat(bind, np.asarray(model.skin_bonebindquat[bone], np.float64))
        turn = data.xmat[body].reshape(3, 3) @ bind.reshape(3, 3).T
        placed[ids] += weight * ((vertices[ids] - model.skin_bonebindpos[bone]) @ turn.T + data.xpos[body])
    return placed


def top_of_skin(vertices: F64, faces: npt.NDArray[np.integer], place: npt.ArrayLike) -> float:
    """Height [m] of the highest skin on the vertical line through a place (2,); NaN if it meets none."""
    # On which sides of the place each vertex lies; a triangle round the place has vertices on all four.
    flat = vertices[:, :2]
    sides = np.packbits(np.hstack([flat <= np.asarray(place), flat >= np.asarray(place)]), axis=1)[:, 0]
    near = np.bitwise_or.reduce(sides[faces], axis=1) == ALL_SIDES
    a, b, c = np.moveaxis(vertices[faces[near]], 1, 0)
    # Barycentric coordinates of the place in each triangle's shadow.
    u, v, w = (b - a)[:, :2], (c - a)[:, :2], np.asarray(place, np.float64) - a[:, :2]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    upright = np.abs(area) < 1e-14
    area = np.where(upright, 1.0, area)
    beta = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    gamma = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    inside = ~upright & (beta >= -1e-9) & (gamma >= -1e-9) & (beta + gamma <= 1 + 1e-9)
    heights = a[:, 2] + beta * (b - a)[:, 2] + gamma * (c - a)[:, 2]
    return float(heights[inside].max()) if inside.any() else float("nan")
