"""Computes where tool and cameras are from the cell's calibration and the encoders alone: a check of the poses that a
policy is sent, by other code than that which made them."""

from __future__ import annotations

from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import Baked
from carecontact.contract.geometry import matrix_from_quat

F64 = npt.NDArray[np.float64]

SAME = 1e-12
"""Largest difference that counts as none, in matrix entries [1] and lengths [m]: a hundred times what rounding leaves
between two orders of multiplying the same matrices."""


def pose_hand_in_base(arm: str, joint_position: F64) -> F64:
    """Return the pose (4, 4) of the hand for joint angles (joints,) [rad], by the frames of a baked arm. Every joint
    turns about the z axis of its frame.
    """
    with resources.as_file(Baked(name=arm).file()) as path, np.load(path) as asset:
        positions, quats = asset["frame_position_m"], asset["frame_quat"]
    pose = np.eye(4)
    for i, (position, quat) in enumerate(zip(positions, quats, strict=True)):
        pose = pose @ _pose(position, quat / np.linalg.norm(quat))
        if i < len(joint_position):
            cos, sin = np.cos(joint_position[i]), np.sin(joint_position[i])
            pose[:3, :3] = pose[:3, :3] @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return pose


def pose_camera_in_base(camera: dict[str, Any], cell: dict[str, Any], hand_in_base: F64) -> F64:
    """Return the pose (4, 4) of one camera of the protocol in the robot's base, with OpenCV's axes."""
    position = np.array(camera["position_m"], np.float64)
    forward = np.array(camera["look_at_m"]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.array(camera["up"], np.float64))
    right /= np.linalg.norm(right)
    in_mount = np.eye(4)
    in_mount[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    in_mount[:3, 3] = position
    if camera["mount"] == "hand":
        return hand_in_base @ in_mount
    half = np.radians(cell["robot_yaw_deg"]) / 2
    base_in_world = _pose(np.array(cell["robot_base_m"]), np.array([np.cos(half), 0.0, 0.0, np.sin(half)]))
    return np.linalg.inv(base_in_world) @ in_mount


def intrinsics(camera: dict[str, Any]) -> F64:
    """Return the intrinsic matrix (3, 3) [px] of a camera of the protocol."""
    focal = camera["height"] / 2 / np.tan(np.radians(camera["fovy_deg"]) / 2)
    return np.array([[focal, 0, (camera["width"] - 1) / 2], [0, focal, (camera["height"] - 1) / 2], [0, 0, 1.0]])


def _pose(position: F64, quat_wxyz: F64) -> F64:
    pose = np.eye(4)
    pose[:3, :3] = matrix_from_quat(quat_wxyz)
    pose[:3, 3] = position
    return pose
