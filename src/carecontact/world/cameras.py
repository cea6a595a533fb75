"""Adds the protocol's cameras to the world."""

from __future__ import annotations

import mujoco
import numpy as np

from carecontact.contract.protocol import Camera, Protocol


def look_at(camera: Camera) -> np.ndarray:
    """Return the orientation (4,) wxyz of a MuJoCo camera (x right, y up, looking along -z)."""
    position, target = np.array(camera.position_m), np.array(camera.look_at_m)
    z = position - target
    z /= np.linalg.norm(z)
    x = np.cross(np.array(camera.up), z)
    x /= np.linalg.norm(x)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.stack([x, np.cross(z, x), z], 1).ravel())
    return quat


def add_cameras(spec: mujoco.MjSpec, protocol: Protocol) -> None:
    for name, camera in protocol.cameras.items():
        parent = spec.worldbody if camera.mount == "world" else spec.body(protocol.scene.robot.flange_body)
        parent.add_camera(name=name, pos=camera.position_m, quat=look_at(camera), fovy=camera.fovy_deg,
                          resolution=[camera.width, camera.height])  # fmt: skip
