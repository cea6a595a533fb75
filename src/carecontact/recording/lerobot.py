"""Recordings as episodes of a LeRobotDataset: one row for each action that the robot executed, or rows at a rate."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.interface.geometry import pose_matrix, quat_from_matrix
from carecontact.interface.learned import DatasetRows
from carecontact.interface.observation import Observation
from carecontact.interface.policy import CAMERAS
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.pictures import Pictures
from carecontact.recording.schema import Header, Recording

F32 = npt.NDArray[np.float32]
LOOKED = "policy/looked"
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of a pose: position [m] and quaternion."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """The values of one quantity in every row of an episode."""

    names: tuple[str, ...]
    values: npt.NDArray[Any]
    """(M, len(names)), or (M, N, len(names))"""


@dataclass(frozen=True, kw_only=True)
class Clip:
    """The pictures of one camera as a film."""

    path: Path
    """Place of the film, which a dataset may move into its own folder."""
    shape: tuple[int, int, int]
    """(height, width, 3)"""
    histogram: npt.NDArray[np.int64]
    """(3, 256) as ``histogram_of``"""


@dataclass(frozen=True, kw_only=True)
class Episode:
    instruction: str
    fps: float
    """Number of rows in a second of simulated time, an int where it is whole."""
    streams: dict[str, Stream]
    images: Mapping[str, Sequence[npt.NDArray[np.uint8]]] = field(default_factory=dict[str, Any])
    """Camera -> (H, W, 3) images, in the order in which they were sent."""
    shown: Mapping[str, npt.NDArray[np.int64]] = field(default_factory=dict[str, Any])
    """Camera -> (M,) index of the image that the policy had when it chose the action."""
    clips: Mapping[str, Clip] = field(default_factory=dict[str, Clip])
    """Camera -> film with an image for every row, in place of ``images``."""

    def __len__(self) -> int:
        return len(self.streams["action"].values)


def episode_of(recording: Recording, *, force: bool = False) -> Episode:
    """Return the trial's episode; ``force`` adds ``scorer.force``, the robot's force on each segment [N], which no
    policy receives. Raises RecordingError for a trial without an action or whole pictures, or with uneven actions."""
    header = recording.header
    title = header.spec.trial_id
    if header.card is None or not len(recording["actions/time_s"]):
        raise RecordingError(f"{title}: the policy did no action")
    spec, card = header.spec, header.card
    index = recording["actions/observation_index"].astype(np.int64)
    # Where an action kept the last target, that one; before any, the tool's own pose.
    if "actions/joint" in recording:
        targets = recording["actions/joint"]
        names, before = tuple(f"joint{k + 1}" for k in range(targets.shape[1])), np.zeros(targets.shape[1])
    else:
        targets, names, before = recording["actions/pose_tcp_in_base"], POSE, _tool(recording)[0]
    held = _held(targets, before, np.arange(len(targets))).astype(np.float32)
    streams = {"action": Stream(names=names, values=held)}
    if spec.protocol.variation.encoder_noise_rad == 0:
        streams["observation.state"] = Stream(names=POSE, values=_tool(recording))
    seen_s = recording["policy/observation_time_s"][index]
    age = (recording["actions/time_s"] - seen_s)[:, None].astype(np.float32)
    streams["observation.age_s"] = Stream(names=("age_s",), values=age)
    if force:
        rows = _steps(recording)
        norm = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][rows], axis=2)
        streams["scorer.force"] = Stream(names=tuple(header.segments), values=norm.astype(np.float32))
    cameras: list[str] = card["cameras"] if "rgb" in card["modalities"] else []
    taken = {camera: _taken(recording, camera)[index] for camera in cameras}
    if LOOKED in recording.arrays and cameras:
        seen = np.stack([recording["policy/observation_time_s"][taken[camera]] for camera in cameras], 1)
        age = (recording["actions/time_s"][:, None] - seen).astype(np.float32)
        streams["observation.view_age_s"] = Stream(names=tuple(cameras), values=age)
    pictures = Pictures(recording)
    for camera, at in taken.items():
        if absent := sorted({int(k) for k in at if (int(k), camera, "rgb") not in pictures}):
            raise RecordingError(
                f"{title}: the recording does not hold the image of {camera} at observation {absent[0]}"
            )
    return Episode(
        instruction=spec.protocol.task(spec.task_id).prompt,
        fps=_fps(recording, title),
        streams=streams,
        images={camera: _Images(pictures, camera, np.unique(at).tolist()) for camera, at in taken.items()},
        shown={camera: np.unique(at, return_inverse=True)[1] for camera, at in taken.items()},
    )


def _fps(recording: Recording, title: str) -> float:
    """Return the rate of the actions: the card's, or a lower one if every single-action answer came after a latency."""
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


def _taken(recording: Recording, camera: str) -> npt.NDArray[np.int64]:
    """(A,) for each observation the one whose view of the camera it held; the first has a view of every camera."""
    own = np.arange(len(recording["policy/observation_time_s"]))
    if LOOKED not in recording.arrays:
        return own
    new = recording[LOOKED][:, CAMERAS.index(camera)] > 0
    return np.maximum.accumulate(np.where(new, own, 0))


class _Images(Sequence[npt.NDArray[np.uint8]]):
    """The colour images of a camera at some observations, each made when it is used."""

    def __init__(self, pictures: Pictures, camera: str, indices: list[int]) -> None:
        self._pictures, self._camera, self._indices = pictures, camera, indices

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, at: Any) -> Any:
        return self._pictures[self._indices[at], self._camera, "rgb"]


LAG = ("lag_x", "lag_y", "lag_z", "lag_rx", "lag_ry", "lag_rz")
DELTA = ("dx", "dy", "dz", "rx", "ry", "rz")


def rows_of(recording: Recording, seen: Sequence[Observation], *, hz: float, success: bool) -> dict[str, Stream]:
    """Return the streams of rows at a rate: state, absolute and relative action, and how the trial ended.

    Row t holds the state at the time t / hz and the target that was given there. The tool reaches a target about 0.35 s
    later. Where the recording holds what a demonstrator chose, that is ``action``, and ``action.executed`` is what the
    robot was given. A delta is from the target of the row before to ``action``, and the lag from the tool to it.

    Args:
        seen: observations at these times, from t = 0 on, one for each row.
        success: whether the trial passed its gate safely.

    Raises RecordingError for a trial without an action, or one whose actions are no poses of the tool.
    """
    arrays, header = recording.arrays, recording.header
    if not len(arrays["actions/time_s"]) or "actions/joint" in arrays:
        raise RecordingError(f"{header.spec.trial_id}: rows at a rate need actions that are poses of the tool")
    start, half_s = seen[0].pose_tcp_in_base, header.spec.protocol.physics.dt_s / 2
    times_s = np.arange(len(seen)) / hz
    given = np.searchsorted(arrays["actions/time_s"], times_s + half_s, side="right") - 1
    executed = _held(arrays["actions/pose_tcp_in_base"], start, given)
    chosen, done, ends = executed, np.zeros(len(seen)), float(header.ended == "done")
    if "actions/demonstrated" in arrays:
        label = arrays["actions/demonstrated"]
        chosen = _held(label[:, :7], start, given)
        done, ends = np.where(given < 0, 0.0, label[given, 7]), label[-1, 7]
    # The action that ends a trial may lie between two rows.
    done[-1] = max(done[-1], ends)
    before = np.vstack([start, executed[:-1]])
    relative = [
        DatasetRows.convention.delta(pose, measured=last, last=last) for pose, last in zip(chosen, before, strict=True)
    ]
    rows, joints = DatasetRows(), range(1, 1 + len(seen[0].joint_position))
    rows.begin(seen[0])
    states: list[npt.NDArray[np.float32]] = []
    for each, target in zip(seen, executed, strict=True):
        states.append(rows.state(each))
        rows.target = target
    names = (*POSE, *(f"joint{k}" for k in joints), *(f"velocity{k}" for k in joints), *LAG)
    last = np.arange(len(seen)) == len(seen) - 1
    streams = {
        "observation.state": _stream(names, states),
        "action": _stream((*POSE, "done"), _same_sign(chosen), done[:, None]),
        "action.delta": _stream((*DELTA, "done"), relative, done[:, None]),
        "next.done": Stream(names=("done",), values=last[:, None]),
        "next.success": Stream(names=("success",), values=(last & success)[:, None]),
        "person": Stream(names=("person",), values=np.full((len(seen), 1), person_of(header.spec))),
    }
    if "actions/demonstrated" in arrays:
        streams["action.executed"] = _stream(POSE, _same_sign(executed))
    return streams


def person_of(spec: TrialSpec) -> int:
    """Return a number for a trial's person, the same on all levels and tasks, that reveals neither seed nor salt."""
    text = f"{spec.commitment} {spec.protocol.drawn_as} {spec.seed}"
    return int(hashlib.sha256(text.encode()).hexdigest()[:12], 16)


def _stream(names: tuple[str, ...], *parts: Any) -> Stream:
    return Stream(names=names, values=np.hstack([np.asarray(part, np.float32) for part in parts]))


def _held(poses: npt.NDArray[Any], before: npt.NDArray[Any], rows: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """(M, D) the target in force at each row. ``rows``: number of the row's last action, -1 before the first."""
    known = np.vstack([before, poses])
    last = np.maximum.accumulate(np.where(np.isnan(known).any(axis=1), 0, np.arange(len(known))))
    return known[last][rows + 1]


def _same_sign(poses: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Of a quaternion and its negative, keep one: the first with a positive largest number, the next by continuity."""
    quats = poses[:, 3:]
    first = np.sign(quats[0, np.abs(quats[0]).argmax()])
    turned = np.cumprod(np.where(np.sum(quats[1:] * quats[:-1], axis=1) < 0, -1.0, 1.0))
    return np.hstack([poses[:, :3], quats * first * np.append(1.0, turned)[:, None]])


def histogram_of(images: Sequence[Any], shown: Any) -> npt.NDArray[np.int64]:
    """(3, 256) how often each channel has each level, over all pixels of all rows. ``shown``: image of each row."""
    total = np.zeros((3, 256), np.int64)
    for image, rows in zip(images, np.bincount(shown, minlength=len(images)), strict=True):
        total += rows * np.array([np.bincount(image[:, :, channel].ravel(), minlength=256) for channel in range(3)])
    return total


def about_dataset(header: Header, *, rendered: bool, trials: str) -> str:
    """Return what README.md of a dataset says of its trials. ``header``: of any of them; ``trials``: which of them, as
    sentences."""
    spec = header.spec
    shown = "was given the simulation" if header.privileged else "received only what a policy receives"
    persons = (
        "persons to train on, whom a public salt draws and no exam has"
        if spec.trains
        else "the protocol's own persons: **a policy that is trained on them must not be tested on them**"
    )
    return f"""# {spec.protocol.title}

- Demonstrator: {spec.policy}, which {shown} (privileged: {str(header.privileged).lower()}).
- Persons: {persons}. Sha256 of the salt: {spec.commitment or "none"}. Trials: {trials}
- Protocol: {spec.protocol.title}, sha256 {spec.protocol.sha256}.
{ROWS if rendered else ""}"""


ROWS = """\
- A row holds the state at its time and the target that was given at that state. The tool arrives about 0.35 s later.
- `action` is absolute: position [m] and quaternion (w, x, y, z) of the tool in the robot's base, and 1 where the trial
  is declared done. `action.delta` leads from the target of the row before to `action`: translation [m] and rotation
  vector [rad] along the axes of the base. `action.executed`, if any, is what the robot was given where that was
  disturbed or chosen by another policy; `action` is then what the demonstrator wanted.
- `observation.state` ends with the lag, from the tool to the target before: the tool feels through it. In a run,
  `DatasetRows` of `carecontact.interface.learned` makes the same state, and actions of rows of `action`.
- Pictures are the middle square of the camera's, each pixel the mean of the area that it covers.
- Split by `person`: a person appears in several tasks.
"""
