"""The log of what an audited trial showed its policy, and what a process without a simulator computes from it.

A trial is a folder: ``trial.json``, ``spec.json`` and a ``look-NNNN.npz`` for each observation. An ordinary trial
writes none of it. Only the process that draws the images again uses ``spec.json`` and ``LoggedLook.state``. Poses are
computed from the cell's calibration and the encoders alone, by other code than that which made those that were sent.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import F64, Observation
from carecontact.interface.robot import Baked
from carecontact.protocol.protocol import TrialSpec
from carecontact.sensing.builder import RawReadings, RawView


def differences(expected: Any, got: Any, place: str) -> list[tuple[str, str]]:
    """Return a pair of place and difference for every leaf of two values that differs in any bit."""
    if isinstance(expected, dict) and isinstance(got, dict):
        out = [(f"{place}.{key}", "is present, but must not be") for key in sorted(got.keys() - expected.keys())]
        out += [(f"{place}.{key}", "is missing") for key in sorted(expected.keys() - got.keys())]
        for key in sorted(expected.keys() & got.keys()):
            out += differences(expected[key], got[key], f"{place}.{key}")
        return out
    if isinstance(expected, list | tuple) and isinstance(got, list | tuple) and len(expected) == len(got):
        pairs = enumerate(zip(expected, got, strict=True))
        return [found for index, (a, b) in pairs for found in differences(a, b, f"{place}[{index}]")]
    if isinstance(expected, np.ndarray) and isinstance(got, np.ndarray):
        what = _of_arrays(expected, got)
        return [(place, what)] if what else []
    # Only NaN differs from itself.
    if type(expected) is type(got) and (expected == got or (expected != expected and got != got)):
        return []
    return [(place, f"expected {expected!r:.100}, got {got!r:.100}")]


def message_differences(expected: Any, got: Any) -> list[tuple[str, str]]:
    """Return the differences of two messages that are not the same bytes, not even in how they are packed."""
    found = [(place.removeprefix("message."), what) for place, what in differences(expected, got, "message")]
    return found or [("message", "the same values are packed in other bytes")]


def _of_arrays(expected: np.ndarray, got: np.ndarray) -> str:
    if expected.dtype != got.dtype or expected.shape != got.shape:
        return f"expected {expected.dtype} {expected.shape}, got {got.dtype} {got.shape}"
    if expected.tobytes() == got.tobytes():
        return ""
    a, b = (np.ascontiguousarray(x).reshape(-1) for x in (expected, got))
    other = (a.view("u1").reshape(len(a), -1) != b.view("u1").reshape(len(b), -1)).any(1)
    with np.errstate(invalid="ignore"):
        away = np.abs(a[other].astype(np.float64) - b[other].astype(np.float64))
    finite = away[np.isfinite(away)]
    size = f", by up to {finite.max():.3g}" if finite.size else ""
    return f"{int(other.sum())} of {len(other)} numbers differ{size}"


SAME = 1e-12
"""Largest difference that counts as none, in matrix entries [1] and lengths [m]: a hundred times what rounding leaves
between two orders of multiplying the same matrices."""


def pose_hand_in_base(arm: str, joint_position: F64) -> F64:
    """Return the pose (4, 4) of the hand for joint angles (joints,) [rad], by the frames of a baked arm, whose joints
    turn about the z axes of their frames."""
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


META, SPEC, FOAM = "trial.json", "spec.json", "foam.npy"
IMAGES = ("rgb", "depth", "robot_depth", "cell_depth")


class Meta(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    policy: str
    instruction: str
    modalities: tuple[str, ...]
    cameras: tuple[str, ...]
    tcp_in_hand_m: tuple[float, float, float]
    cell: dict[str, Any]
    """``arm`` is the name of a baked one; ``robot_base_m``, ``robot_yaw_deg`` and ``cameras`` are the protocol's."""
    calibration: dict[str, list[list[float]]]
    """Fixed camera -> (4, 4) error with which the cell knows its pose (``sensing.calibration``); empty where the
    cell knows the poses exactly."""
    arguments: dict[str, str] = {}
    """The card's arguments. For a dialect, they say how its messages are made."""


@dataclass(frozen=True, kw_only=True)
class WorldState:
    """The simulator's state at an observation, as ``state.StateReader`` reads it."""

    steps: int
    """Physics steps since t = 0."""
    joint_position: F64
    """(joints,) of the robot [rad]"""
    joint_velocity: F64
    """(joints,) of the robot [rad/s]"""
    vector: F64
    """(n,) everything that pictures depend on but the foam, in the order of ``state.DRAWN``."""


@dataclass(frozen=True, kw_only=True)
class LoggedLook:
    sim_time_s: float
    raw: RawReadings
    sent: bytes
    state: WorldState
    foam_left: F64 | None
    """(C,) share of the foam that is left on each cell, as the finished recording gives it; None without foam"""


def write_meta(folder: Path, meta: Meta, spec: TrialSpec) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / META).write_text(meta.model_dump_json())
    (folder / SPEC).write_text(spec.model_dump_json())


def read_meta(folder: Path) -> Meta:
    return Meta.model_validate_json((folder / META).read_text())


def read_spec(folder: Path) -> TrialSpec:
    return TrialSpec.model_validate_json((folder / SPEC).read_text())


STATE = ("joint_position", "joint_velocity", "vector")
RAW = ("joint_position", "joint_velocity", "pose_tcp_in_base", "velocity_tcp_in_base")


def write_look(
    folder: Path, index: int, *, observation: Observation, raw: RawReadings, sent: bytes, state: WorldState
) -> None:
    arrays: dict[str, npt.NDArray[Any]] = {
        "sent": np.frombuffer(sent, np.uint8),
        "sim_time_s": np.array(observation.sim_time_s),
        "state.steps": np.array(state.steps),
        **{name: value for name in RAW if (value := getattr(raw, name)) is not None},
        **{f"state.{name}": getattr(state, name) for name in STATE},
    }
    for camera, view in raw.views.items():
        values = {name: getattr(view, name) for name in ("intrinsics", "pose_camera_in_base", *IMAGES)}
        arrays |= {f"{camera}/{name}": value for name, value in values.items() if value is not None}
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / f"look-{index:04d}.npz", allow_pickle=False, **arrays)


def write_foam(folder: Path, left: F64) -> None:
    np.save(folder / FOAM, left, allow_pickle=False)


def read_looks(folder: Path) -> Iterator[LoggedLook]:
    left = np.load(folder / FOAM, allow_pickle=False) if (folder / FOAM).is_file() else None
    for number, path in enumerate(sorted(folder.glob("look-*.npz"))):
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        views: dict[str, dict[str, npt.NDArray[Any]]] = {}
        for name in arrays:
            camera, slash, image = name.partition("/")
            if slash:
                views.setdefault(camera, {})[image] = arrays[name]
        shown = {camera: RawView(**images) for camera, images in views.items()}
        yield LoggedLook(
            sim_time_s=float(arrays["sim_time_s"]),
            raw=RawReadings(**{name: arrays[name] for name in RAW if name in arrays}, views=shown),
            sent=arrays["sent"].tobytes(),
            state=WorldState(steps=int(arrays["state.steps"]), **{name: arrays[f"state.{name}"] for name in STATE}),
            foam_left=None if left is None else left[number],
        )
