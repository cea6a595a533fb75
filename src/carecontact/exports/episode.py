"""What a policy saw and did in one trial, as one row for each action that the robot executed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import pose_matrix, quat_from_matrix
from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording

F32 = npt.NDArray[np.float32]
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of a pose: position [m] and quaternion."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """The values of one quantity in every row of an episode."""

    names: tuple[str, ...]
    values: F32
    """(M, len(names))"""


@dataclass(frozen=True, kw_only=True)
class Episode:
    instruction: str
    fps: float
    """Number of rows in a second of simulated time, an int where it is whole."""
    streams: dict[str, Stream]
    images: dict[str, list[npt.NDArray[np.uint8]]] = field(default_factory=dict[str, list[Any]])
    """Camera -> (H, W, 3) images, in the order in which they were sent."""
    shown: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """(M,) index of the image that the policy had when it chose the action."""

    def __len__(self) -> int:
        return len(self.streams["action"].values)


def episode_of(recording: Recording, *, force: bool = False) -> Episode:
    """Return the trial's episode. No quantity of the scorer is in it unless ``force`` asks for one.

    Args:
        force: adds ``scorer.force``, the norm of the robot's summed force on each body segment [N], which no policy
            receives.

    Raises RecordingError for a trial without an action, for one whose actions are not evenly spaced in time, and for
    one of which the recording does not hold every image that the policy was sent.
    """
    header = recording.header
    title = header.spec.trial_id
    if header.card is None or not len(recording["actions/time_s"]):
        raise RecordingError(f"{title}: the policy did no action")
    spec, card = header.spec, header.card
    index = recording["actions/observation_index"].astype(np.int64)
    streams = {"action": _action(recording)}
    if spec.protocol.variation.encoder_noise_rad == 0:
        streams["observation.state"] = Stream(names=POSE, values=_tool(recording))
    seen_s = recording["policy/observation_time_s"][index]
    age = (recording["actions/time_s"] - seen_s)[:, None].astype(np.float32)
    streams["observation.age_s"] = Stream(names=("age_s",), values=age)
    if force:
        rows = _steps(recording)
        norm = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][rows], axis=2)
        streams["scorer.force"] = Stream(names=tuple(header.segments), values=norm.astype(np.float32))
    used = sorted(set(index.tolist()))
    cameras = card["cameras"] if "rgb" in card["modalities"] else []
    return Episode(
        instruction=spec.protocol.task(spec.task_id).prompt,
        fps=_fps(recording, title),
        streams=streams,
        images={camera: [_image(recording, title, k, camera) for k in used] for camera in cameras},
        shown=np.searchsorted(used, index),
    )


def _fps(recording: Recording, title: str) -> float:
    """Return the rate at which the recorded actions began.

    That is the card's control rate, or a lower one if every answer was a single action and came after a latency.
    """
    spec, times_s = recording.header.spec, recording["actions/time_s"]
    dt_s, hz = spec.protocol.physics.dt_s, float((recording.header.card or {})["control_hz"])
    wait_s = round(spec.protocol.phases.latency_s / dt_s) * dt_s
    for rate in (round(1 / (1 / hz + wait_s), 9), hz) if wait_s else (hz,):
        # A control period is a whole number of physics steps, and only its mean is exact.
        if np.abs(times_s - times_s[0] - np.arange(len(times_s)) / rate).max() < 1.5 * dt_s:
            return int(rate) if rate.is_integer() else rate
    apart_s = np.diff(times_s)
    raise RecordingError(
        f"{title}: its actions are {apart_s.min():.3g} to {apart_s.max():.3g} s apart, and a dataset has one rate; "
        "runs of policies that answer several actions at a time can be exported only without --latency-ms"
    )


def _action(recording: Recording) -> Stream:
    """Return the target of each action; where an action kept the last target, that one, and before any the tool's own
    pose."""
    if "actions/joint" in recording.arrays:
        joint = recording["actions/joint"]
        names = tuple(f"joint{k + 1}" for k in range(joint.shape[1]))
        return Stream(names=names, values=_filled(joint, np.zeros(len(names))))
    return Stream(names=POSE, values=_filled(recording["actions/pose_tcp_in_base"], _tool(recording)[0]))


def _filled(values: npt.NDArray[Any], before: npt.NDArray[Any]) -> F32:
    out = values.astype(np.float32)
    for row in range(len(out)):
        if np.isnan(out[row]).any():
            out[row] = out[row - 1] if row else before
    return out


def _steps(recording: Recording) -> npt.NDArray[np.int64]:
    """(M,) the physics step at which each action began."""
    steps = np.searchsorted(recording["scorer/time_s"], recording["actions/time_s"] - 1e-9)
    return np.clip(steps, 0, len(recording["scorer/time_s"]) - 1)


def _tool(recording: Recording) -> F32:
    """(M, 7) the tool's pose in the robot's base as its encoders tell it when each action begins."""
    base = recording.header.pose_base_in_world
    to_base = np.linalg.inv(pose_matrix(np.array(base[:3]), np.array(base[3:])))
    rows: list[npt.NDArray[Any]] = []
    for pose in recording["scorer/pose_tcp_in_world"][_steps(recording)].astype(float):
        matrix = to_base @ pose_matrix(pose[:3], pose[3:])
        quat = quat_from_matrix(matrix[:3, :3])
        # A quaternion and its negative are one rotation: keep the sign from row to row.
        if rows and float(quat @ rows[-1][3:]) < 0:
            quat = -quat
        rows.append(np.concatenate([matrix[:3, 3], quat]))
    return np.array(rows, np.float32)


def _image(recording: Recording, title: str, index: int, camera: str) -> npt.NDArray[np.uint8]:
    path = f"policy/frames/{index:04d}/{camera}/rgb"
    if path not in recording.arrays:
        raise RecordingError(f"{title}: the recording does not hold the image of {camera} at observation {index}")
    return recording[path]
