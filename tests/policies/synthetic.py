"""Synthetic sessions and observations that fit the contract."""

from __future__ import annotations

import numpy as np

from carecontact.interface.observation import MASK_NAMES, CameraView, Observation
from carecontact.interface.robot import ActionBounds, Session

BOUNDS = ActionBounds(
    workspace_low_m=(-0.2, -1.1, -0.15),
    workspace_high_m=(0.85, 0.75, 0.9),
    translational_stiffness=(100.0, 1000.0),
    rotational_stiffness=(5.0, 50.0),
)
SESSION = Session(
    action_bounds=BOUNDS,
    joint_low_rad=(-2.9, -1.7, -2.9, -3.0, -2.9, 0.0, -2.9),
    joint_high_rad=(2.9, 1.7, 2.9, -0.1, 2.9, 3.7, 2.9),
    camera_sizes_px={"overhead": (640, 480), "exterior": (640, 360)},
    time_limit_s=30.0,
)


def synthetic_view(*, height: int = 6, width: int = 8, points: int = 5, seed: int = 0) -> CameraView:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 3.0, (height, width)).astype(np.float32)
    depth[0, 0] = np.nan
    return CameraView(
        intrinsics=np.array([[400.0, 0, width / 2], [0, 400.0, height / 2], [0, 0, 1]]),
        pose_camera_in_base=np.eye(4),
        rgb=rng.integers(0, 256, (height, width, 3), dtype=np.uint8),
        depth=depth,
        points=rng.normal(size=(points, 3)).astype(np.float32),
        point_colors=rng.integers(0, 256, (points, 3), dtype=np.uint8),
        masks={name: rng.random((height, width)) > 0.5 for name in MASK_NAMES},
        landmarks=rng.normal(size=(33, 3)).astype(np.float32),
        landmarks_in_base=rng.normal(size=(33, 3)).astype(np.float32),
    )


def synthetic_observation(*, cameras: dict[str, CameraView] | None = None, sim_time_s: float = 0.0) -> Observation:
    return Observation(
        instruction="gently touch the right forearm",
        sim_time_s=sim_time_s,
        joint_position=np.linspace(-1, 1, 7),
        joint_velocity=np.zeros(7),
        gripper_position=np.zeros(1),
        pose_tcp_in_base=np.array([0.4, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0]),
        cameras=cameras or {},
    )
