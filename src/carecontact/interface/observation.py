"""The observation: everything that a policy receives during a trial, and nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

Modality = Literal["rgb", "depth", "points", "masks", "landmarks"]
MODALITIES: tuple[str, ...] = get_args(Modality)
MASK_NAMES = ("human", "robot", "bed", "background")

F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class CameraView:
    """One camera at one instant. Modalities that the policy's card did not name are None."""

    intrinsics: F64
    """(3, 3) pinhole matrix [px]: u right, v down."""
    pose_camera_in_base: F64
    """(4, 4) camera -> robot base, OpenCV axes: x right, y down, z forward [m]. As the cell's calibration and encoders
    have it; a protocol may give them errors."""
    rgb: U8 | None = None
    """(H, W, 3)"""
    depth: F32 | None = None
    """(H, W) distance along the optical axis [m], NaN beyond range."""
    points: F32 | None = None
    """(N, 3) in base [m]"""
    point_colors: U8 | None = None
    """(N, 3)"""
    masks: dict[str, Bool] | None = None
    """MASK_NAMES -> (H, W)"""
    landmarks: F32 | None = None
    """(33, 3): u [px], v [px], visibility in [0, 1]; MediaPipe Pose order. All NaN: no person found."""
    landmarks_in_base: F32 | None = None
    """(33, 3) surface point under each landmark in base [m], NaN where depth does not allow one."""
    sim_time_s: float = math.nan
    """When the view was taken [s]. An observation gives its own time to a view that has none."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    instruction: str
    sim_time_s: float
    """Since t = 0, the moment of reset."""
    joint_position: F64
    """(joints,) robot encoders [rad]"""
    joint_velocity: F64
    """(joints,) [rad/s], from the encoders"""
    gripper_position: F64
    """(1,) opening in [0, 1]; the closed-gripper embodiment always reads 0"""
    pose_tcp_in_base: F64
    """(7,) position [m], quat_wxyz"""
    velocity_tcp_in_base: F64 | None = None
    """(6,) velocity of the tool centre point [m/s] and angular velocity of the tool [rad/s], along the axes of the
    base, as angles and speeds of the joints give them; None unless the card requests it (``tool_velocity``)"""
    cameras: dict[str, CameraView] = field(default_factory=dict[str, CameraView])
    """The last view of each camera. ``new`` names those that were taken for this observation."""

    def __post_init__(self) -> None:
        timed = {
            name: replace(view, sim_time_s=self.sim_time_s) if math.isnan(view.sim_time_s) else view
            for name, view in self.cameras.items()
        }
        object.__setattr__(self, "cameras", timed)

    @property
    def new(self) -> tuple[str, ...]:
        """The cameras whose views were taken for this observation; the card and the actions decide which
        (``PolicyCard.camera_hz``, ``Action.look``)."""
        return tuple(name for name, view in self.cameras.items() if view.sim_time_s == self.sim_time_s)


class LastViews:
    """Completes the observations of one trial with the last view of every camera that took none for them."""

    def __init__(self) -> None:
        self._views: dict[str, CameraView] = {}

    def completed(self, observation: Observation) -> Observation:
        """Return an observation, which holds new views only, with the earlier views beside them."""
        self._views |= observation.cameras
        return replace(observation, cameras=self._views)

    def forget(self) -> None:
        """Forget all views, because a new trial begins."""
        self._views = {}
