"""A session and an observation, for benchmarks that have no trial."""

import numpy as np

from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.robot import ActionBounds, Session

BOUNDS = ActionBounds(
    workspace_low_m=(0.0, -1.0, 0.0),
    workspace_high_m=(1.0, 1.0, 1.0),
    translational_stiffness=(100.0, 1000.0),
    rotational_stiffness=(5.0, 50.0),
)
LIMITS = {"joint_low_rad": (-3.0,) * 7, "joint_high_rad": (3.0,) * 7, "time_limit_s": 30.0}
SESSION = Session(action_bounds=BOUNDS, camera_sizes_px={}, **LIMITS)


def observation(cameras: dict[str, CameraView] | None = None) -> Observation:
    """Return an observation of a robot at rest."""
    return Observation(
        instruction="gently touch the right forearm",
        sim_time_s=0.0,
        joint_position=np.zeros(7),
        joint_velocity=np.zeros(7),
        gripper_position=np.zeros(1),
        pose_tcp_in_base=np.array([0.4, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0]),
        cameras=cameras or {},
    )
