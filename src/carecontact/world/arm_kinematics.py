"""Kinematics and inertia of the robot's arm for many postures at once, which decide where the robot can stand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.robot import Baked, Robot
from carecontact.world.robot import JOINT_ARMATURE, arrays_of

Array = npt.NDArray[np.float64]


class Arm:
    """Forward kinematics and inertia of the baked arm, vectorized over postures (B, joints), in the base frame."""

    def __init__(self, robot: Robot) -> None:
        """Raises SceneError for a robot whose arm is not baked, and for one without a reach."""
        if not isinstance(robot.source, Baked) or robot.reach is None:
            raise SceneError(f"robot {robot.id}: only a baked arm with a reach can be asked where its base may stand")
        self.reach, self.joints, self._tcp_z_m = robot.reach, len(robot.joints), robot.tcp_z_m
        asset = arrays_of(robot.source)
        self.frames = np.stack(
            [pose_matrix(p, q) for p, q in zip(asset["frame_position_m"], asset["frame_quat"], strict=True)]
        )
        self.range = np.asarray(asset["joint_range_rad"], np.float64)
        self.mass = np.asarray(asset["mass_kg"], np.float64)[1:]
        self.com = np.asarray(asset["centre_of_mass_m"], np.float64)[1:]
        xx, yy, zz, xy, xz, yz = np.asarray(asset["inertia_kgm2"], np.float64)[1:].T
        self.inertia = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).reshape(-1, 3, 3)

    def links(self, q: Array) -> Array:
        """Return the poses (B, joints + 2, 4, 4) of all links that move, the hand and the tool centre point."""
        pose = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        out = []
        for i in range(self.joints):
            turn = np.tile(np.eye(4), (len(q), 1, 1))
            turn[:, 0, 0] = turn[:, 1, 1] = np.cos(q[:, i])
            turn[:, 1, 0] = np.sin(q[:, i])
            turn[:, 0, 1] = -turn[:, 1, 0]
            pose = pose @ self.frames[i] @ turn
            out.append(pose)
        out.append(pose @ self.frames[self.joints])
        out.append(out[-1] @ pose_matrix(np.array([0, 0, self._tcp_z_m]), np.array([1.0, 0, 0, 0])))
        return np.stack(out, 1)

    def jacobian(self, links: Array) -> Array:
        """Return the Jacobian (B, 6, joints) of the tool centre point: three linear rows, then three angular ones."""
        axes, origins = links[:, :-2, :3, 2], links[:, :-2, :3, 3]
        linear = np.cross(axes, links[:, -1, None, :3, 3] - origins)
        return np.concatenate([linear, axes], 2).swapaxes(1, 2)

    def mass_matrix(self, links: Array) -> Array:
        axes, origins = links[:, :-2, :3, 2], links[:, :-2, :3, 3]
        total = np.tile(np.eye(self.joints) * JOINT_ARMATURE, (len(links), 1, 1))
        for k in range(self.joints + 1):
            moves = (np.arange(self.joints) <= k)[None, :, None]
            centre = links[:, k, :3, :3] @ self.com[k] + links[:, k, :3, 3]
            linear = np.cross(axes, centre[:, None] - origins) * moves
            angular = axes * moves
            world_inertia = links[:, k, :3, :3] @ self.inertia[k] @ links[:, k, :3, :3].swapaxes(1, 2)
            total += self.mass[k] * linear @ linear.swapaxes(1, 2)
            total += angular @ world_inertia @ angular.swapaxes(1, 2)
        return total

    def margin(self, q: Array) -> Array:
        """Return (B,) the least distance of any joint from its limit over half its range; 1 is the middle."""
        half = np.ptp(self.range, axis=1) / 2
        return (np.minimum(q - self.range[:, 0], self.range[:, 1] - q) / half).min(1)

    def measures(self, q: Array) -> tuple[Array, Array]:
        """Return manipulability sqrt(det(J J^T)) (B,) and the tool's effective mass (B,) [kg] along the vertical."""
        links = self.links(q)
        jacobian = self.jacobian(links)
        manipulability = np.sqrt(np.maximum(np.linalg.det(jacobian @ jacobian.swapaxes(1, 2)), 0))
        row = jacobian[:, 2:3]
        mobility = row @ np.linalg.solve(self.mass_matrix(links), row.swapaxes(1, 2))
        return manipulability, 1.0 / mobility[:, 0, 0]

    @staticmethod
    def pose_error(links: Array, position: Array, rotation: Array) -> Array:
        tcp = links[:, -1]
        turn = 0.5 * np.cross(tcp[:, :3, :3], rotation, axis=1).sum(2)
        return np.concatenate([position - tcp[:, :3, 3], turn], 1)


def pointing_down(yaw: Array) -> Array:
    """Return rotations (..., 3, 3): the tool's z points down, the hand's x is ``yaw`` [rad] from world x."""
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    columns = [np.stack([c, s, zero], -1), np.stack([s, -c, zero], -1), np.stack([zero, zero, zero - 1], -1)]
    return np.stack(columns, -1)


def follow(
    arm: Arm, parked: Array, goal: Array, goal_yaw: Array, start_yaw: Array, turn: Array, *, steps: int = 25
) -> tuple[Array, Array]:
    """Follow straight paths of the tool while the null space pulls the posture toward ``parked``, as the impedance
    does.

    Args:
        parked: (B, joints) postures from which the paths begin.
        goal: (B, 3) where they end, in base.
        goal_yaw, start_yaw: (B,) of the tool in world [rad], which points down.
        turn: (3, 3) base -> world.

    Returns:
        Postures (steps, B, joints), and the largest pose error on each path (B,), metres and radians in one norm.
    """
    start = arm.links(parked)[:, -1, :3, 3]
    swing = (goal_yaw - start_yaw + np.pi) % (2 * np.pi) - np.pi
    q, path = parked.copy(), []
    error = np.zeros(len(q))
    for k in range(1, steps + 1):
        share = k / steps
        position = start + share * (goal - start)
        rotation = turn.T @ pointing_down(start_yaw + share * swing)
        for _ in range(3):
            links = arm.links(q)
            jacobian = arm.jacobian(links)
            pose_error = arm.pose_error(links, position, rotation)
            inverse = np.linalg.solve(jacobian @ jacobian.swapaxes(1, 2) + 1e-6 * np.eye(6), jacobian).swapaxes(1, 2)
            wish = 0.1 * (parked - q)
            task = (jacobian @ wish[:, :, None])[:, :, 0]
            q = q + (inverse @ (pose_error - task)[:, :, None])[:, :, 0] + wish
            q = np.clip(q, arm.range[:, 0], arm.range[:, 1])
        error = np.maximum(error, np.linalg.norm(arm.pose_error(arm.links(q), position, rotation), axis=1))
        path.append(q)
    return np.stack(path), error
