"""Logs what an audited trial showed its policy, and the readings behind it, for a process without a simulator.

A trial is a folder: ``trial.json``, ``spec.json`` and a ``look-NNNN.npz`` for each observation. An ordinary trial
writes none of it. Only the process that draws the images again uses ``spec.json`` and ``LoggedLook.state``; the one
that derives the messages again, without a simulator, uses neither.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.observation import Observation
from carecontact.contract.trial import TrialSpec
from carecontact.observation.builder import RawReadings, RawView

META, SPEC = "trial.json", "spec.json"
IMAGES = ("rgb", "depth", "robot_depth", "cell_depth")


@dataclass(frozen=True, kw_only=True)
class Meta:
    policy: str
    """Name of the policy that showed the card."""
    instruction: str
    modalities: tuple[str, ...]
    cameras: tuple[str, ...]
    tcp_in_hand_m: tuple[float, float, float]
    cell: dict[str, Any]
    """``arm`` is the name of a baked one; ``robot_base_m``, ``robot_yaw_deg`` and ``cameras`` are the protocol's."""
    calibration: dict[str, list[list[float]]]
    """Fixed camera -> (4, 4) error with which the cell knows its pose (``observation.calibration``); empty where the
    cell knows the poses exactly."""
    arguments: dict[str, str] = field(default_factory=dict[str, str])
    """The card's arguments. For a dialect, they say how its messages are made."""


@dataclass(frozen=True, kw_only=True)
class WorldState:
    """The simulator's state at an observation, as ``state.StateReader`` reads it."""

    steps: int
    """Physics steps since t = 0."""
    joint_position: npt.NDArray[np.float64]
    """(joints,) of the robot [rad]"""
    joint_velocity: npt.NDArray[np.float64]
    """(joints,) of the robot [rad/s]"""
    vector: npt.NDArray[np.float64]
    """(n,) everything that pictures depend on, in the order of ``state.DRAWN``."""


@dataclass(frozen=True, kw_only=True)
class LoggedLook:
    sim_time_s: float
    raw: RawReadings
    sent: bytes
    state: WorldState


def write_meta(folder: Path, meta: Meta, spec: TrialSpec) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / META).write_text(json.dumps(asdict(meta)))
    (folder / SPEC).write_text(spec.model_dump_json())


def read_meta(folder: Path) -> Meta:
    fields = json.loads((folder / META).read_text())
    for name in ("modalities", "cameras", "tcp_in_hand_m"):
        fields[name] = tuple(fields[name])
    return Meta(**fields)


def read_spec(folder: Path) -> TrialSpec:
    return TrialSpec.model_validate_json((folder / SPEC).read_text())


def write_look(
    folder: Path, index: int, *, observation: Observation, raw: RawReadings, sent: bytes, state: WorldState
) -> None:
    arrays: dict[str, npt.NDArray[Any]] = {
        "sent": np.frombuffer(sent, np.uint8),
        "sim_time_s": np.array(observation.sim_time_s),
        "joint_position": raw.joint_position,
        "joint_velocity": raw.joint_velocity,
        "pose_tcp_in_base": raw.pose_tcp_in_base,
        "state.steps": np.array(state.steps),
        "state.joint_position": state.joint_position,
        "state.joint_velocity": state.joint_velocity,
        "state.vector": state.vector,
    }
    for camera, view in raw.views.items():
        for name in ("intrinsics", "pose_camera_in_base", *IMAGES):
            value = getattr(view, name)
            if value is not None:
                arrays[f"{camera}/{name}"] = value
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / f"look-{index:04d}.npz", allow_pickle=False, **arrays)


def read_looks(folder: Path) -> Iterator[LoggedLook]:
    for path in sorted(folder.glob("look-*.npz")):
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        views: dict[str, dict[str, npt.NDArray[Any]]] = {}
        for name in arrays:
            camera, slash, image = name.partition("/")
            if slash:
                views.setdefault(camera, {})[image] = arrays[name]
        yield LoggedLook(
            sim_time_s=float(arrays["sim_time_s"]),
            raw=RawReadings(
                joint_position=arrays["joint_position"],
                joint_velocity=arrays["joint_velocity"],
                pose_tcp_in_base=arrays["pose_tcp_in_base"],
                views={camera: RawView(**images) for camera, images in views.items()},
            ),
            sent=arrays["sent"].tobytes(),
            state=WorldState(
                steps=int(arrays["state.steps"]),
                joint_position=arrays["state.joint_position"],
                joint_velocity=arrays["state.joint_velocity"],
                vector=arrays["state.vector"],
            ),
        )
