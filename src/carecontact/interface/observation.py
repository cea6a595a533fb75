"""The observation: everything that a policy receives during a trial, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass, field
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


@dataclass(frozen=True, kw_only=True)
class Observation:
    instruction: str
    sim_time_s: float
    """Since t = 0, the moment of reset."""
    joint_position: F64
    """(joints,) robot encoders [rad]"""
    joint_velocity: F64
    """(joints,) [rad/s]"""
    gripper_position: F64
    """(1,) opening in [0, 1]; the closed-gripper embodiment always reads 0"""
    pose_tcp_in_base: F64
    """(7,) position [m], quat_wxyz"""
    cameras: dict[str, CameraView] = field(default_factory=dict[str, CameraView])
