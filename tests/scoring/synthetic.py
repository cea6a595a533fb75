"""Recordings with known content, made without a simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.interface.regions import REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording import SEGMENTS, Failure, Header, Recording, empty_arrays
from carecontact.recording.provenance import DECLARED

F64 = npt.NDArray[np.float64]
PROTOCOL = load_protocol("bathing-v3")
DT = 0.002
JOINTS = ["right_shoulder_abduction", "right_elbow_flexion"]
JOINT_RANGE = [[-0.5, 2.5], [0.0, 2.4]]
REGION_AT = {"forearm": (0.30, 0.65, 0.70), "upper_arm": (0.05, 0.45, 0.70), "abdomen": (-0.05, 0.0, 0.75)}
SIZE = {"forearm": (0.24, 0.045, 0.045), "upper_arm": (0.26, 0.05, 0.05), "abdomen": (0.22, 0.16, 0.11)}
ELSEWHERE, SMALL = (0.50, 0.75, 0.70), (0.18, 0.05, 0.03)
"""Place and size of any other region."""
BASE = [-0.22, 0.62, 0.62, 1.0, 0.0, 0.0, 0.0]


def seconds(duration: float) -> F64:
    """Sample times of a trial that lasts ``duration``."""
    return (np.arange(round(duration / DT)) + 1) * DT


def hold(duration: float, start: float, stop: float, force: float) -> F64:
    """(T,) a constant normal force between two times [N]."""
    t = seconds(duration)
    return np.where((t > start) & (t <= stop), force, 0.0)


def back_and_forth(duration: float, region: str, *, amplitude: float, period: float) -> F64:
    """(T, 3) TCP on the region's surface in its frame, swinging along the axis."""
    path = np.zeros((round(duration / DT), 3))
    path[:, 0] = amplitude * np.sin(2 * np.pi * seconds(duration) / period)
    path[:, 2] = SIZE[region][2]
    return path


def make_recording(
    task_id: str = "T1",
    *,
    duration: float = 3.0,
    normal: Mapping[str, F64] | None = None,
    tcp_in_region: F64 | None = None,
    wrist_shift: F64 | None = None,
    joints: F64 | None = None,
    speed: float | F64 = 0.1,
    targets_in_region: list[tuple[float, tuple[float, float, float]]] | None = None,
    ended: str = "done",
    modalities: tuple[str, ...] = ("rgb", "depth"),
    failure: Failure | None = None,
    seed: int = 0,
    policy: str = "synthetic",
    extra: Mapping[str, npt.NDArray[Any]] | None = None,
    protocol: Protocol | None = None,
) -> Recording:
    """``normal`` maps segments to (T,) normal forces [N] that push straight down, so norm and normal sum agree.

    Targets are (time, TCP position in the task's region frame); regions lie still and unrotated. A trial that was cut
    was cut by its force where one is above the line, else by the solver.
    """
    protocol = protocol or PROTOCOL
    regions = protocol.regions
    at, size = ([table.get(r, other) for r in regions] for table, other in ((REGION_AT, ELSEWHERE), (SIZE, SMALL)))
    spec = TrialSpec(protocol=protocol, task_id=task_id, seed=seed, policy=policy)
    region = protocol.task(task_id).region
    t = seconds(duration)
    steps = len(t)
    arrays = empty_arrays(len(JOINTS), regions=len(regions))
    own = regions.index(region)

    force = np.zeros((steps, len(SEGMENTS)), np.float32)
    for segment, signal in (normal or {}).items():
        force[:, SEGMENTS.index(segment)] = signal
    vector = np.zeros((steps, len(SEGMENTS), 3), np.float32)
    vector[..., 2] = -force
    tcp = np.zeros((steps, 7), np.float32)
    tcp[:, 3] = 1.0
    hover = np.tile([0.0, 0.0, size[own][2] + 0.05], (steps, 1))
    tcp[:, :3] = np.array(at[own]) + (hover if tcp_in_region is None else tcp_in_region)
    pose = np.zeros((steps, len(regions), 7), np.float32)
    pose[..., :3] = at
    pose[..., 3] = 1.0
    wrist = np.tile([0.42, 0.65, 0.70], (steps, 1))
    if wrist_shift is not None:
        wrist[:, 1] += wrist_shift
    periods = t[9::10]
    indentation = np.array([0.003 if REGIONS[r].soft else 0.0 for r in regions], np.float32)
    targets = targets_in_region or []
    given = np.full((len(targets), 7), np.nan)
    for row, (_, position) in zip(given, targets, strict=True):
        row[:] = [*(np.array(at[own]) + position - BASE[:3]), 1.0, 0.0, 0.0, 0.0]

    arrays |= {
        "scorer/time_s": t,
        "scorer/force_human_from_robot_in_world": vector,
        "scorer/normal_force": force,
        "scorer/centroid_in_world": np.zeros((steps, len(SEGMENTS), 3), np.float32),
        "scorer/human_joint_position": np.full((steps, 2), 1.0, np.float32) if joints is None else np.float32(joints),
        "scorer/human_joint_range": np.array(JOINT_RANGE),
        "scorer/human_joint_settled": np.array([1.0, 1.0]),
        "scorer/wrist_in_world": wrist.astype(np.float32),
        "scorer/wrist_settled_in_world": np.array([0.42, 0.65, 0.70]),
        "scorer/pose_tcp_in_world": tcp,
        "scorer/tcp_speed": np.broadcast_to(np.float32(speed), (steps,)).copy(),
        "scorer/tcp_rotation_speed": np.zeros(steps, np.float32),
        "scorer/region_pose_in_world": pose,
        "scorer/region_size_m": np.array(size),
        "scorer/period_time_s": periods,
        "scorer/indentation_m": np.tile(indentation, (len(periods), 1)),
        "scorer/target_in_base": np.zeros((len(periods), 7), np.float32),
        "actions/time_s": np.array([time for time, _ in targets], np.float64),
        "actions/pose_tcp_in_base": given,
        "actions/stiffness": np.tile([400.0, 20.0], (len(targets), 1)),
        "actions/observation_index": np.zeros(len(targets), np.int32),
        **(extra or {}),
    }
    if ended == "safety_truncation" and failure is None:
        line = protocol.phases.truncation_over_pain
        over = any(np.max(signal) > line * protocol.f_pain(s) for s, signal in (normal or {}).items())
        failure = Failure(kind="force" if over else "solver", message="cut")
    header = Header.model_validate(
        {
            "spec": spec,
            "ended": ended,
            "failure": failure,
            "card": {"name": policy, "modalities": list(modalities), "language_backend": "rules-v1"},
            "embodiment": "panda-closed-gripper",
            "comfort_arm_deg": 50.0,
            "segments": list(SEGMENTS),
            "regions": list(regions),
            "human_joints": JOINTS,
            "pose_base_in_world": BASE,
            "identity": DECLARED,
            "versions": {"carecontact": "0.0.0", "mujoco": "4.0.0"},
            "sha256": {"model": "0" * 64},
            "solver_warnings": [],
        }
    )
    return writable(Recording(header=header, arrays=arrays))


def writable(recording: Recording) -> Recording:
    """A copy whose arrays a test may change, past the check of a recording."""
    return Recording.trusted(recording.header, {path: array.copy() for path, array in recording.arrays.items()})


def target_segment(task_id: str) -> str:
    return REGIONS[PROTOCOL.task(task_id).region].segment


def touch(force: float = 5.0, **options: Any) -> Recording:
    """A good touch of the forearm: 1 s of constant force."""
    return make_recording("T1", normal={"right_forearm": hold(3.0, 1.0, 2.0, force)}, **options)


def push(force: float = 8.0, shift: float = 0.03, **options: Any) -> Recording:
    """A push of the forearm for 1.5 s with the wrist carried ``shift`` sideways."""
    moved = np.where(hold(3.0, 1.0, 2.5, 1.0) > 0, shift, 0.0)
    return make_recording("T2", normal={"right_forearm": hold(3.0, 1.0, 2.5, force)}, wrist_shift=moved, **options)


def scrub(amplitude: float = 0.06, **options: Any) -> Recording:
    """A scrub of the forearm: 4 s of contact while the tool swings along the axis every 2 s."""
    return make_recording(
        "T3",
        duration=6.0,
        normal={"right_forearm": hold(6.0, 1.0, 5.0, 5.0)},
        tcp_in_region=back_and_forth(6.0, "forearm", amplitude=amplitude, period=2.0),
        **options,
    )


def before_start(ended: str = "process_failure") -> Recording:
    """A trial that ended before t = 0."""
    full = make_recording()
    failure = Failure(kind="start" if ended == "process_failure" else "settle", message="it did not start")
    header = full.header.model_copy(update={"ended": ended, "failure": failure, "card": None})
    return writable(Recording(header=header, arrays=empty_arrays(len(JOINTS))))


# The paper's protocol under the exam's gates of each action; test_conduct has those of the whole trial.

EXAM = load_protocol("bathing-wide-v2", level="L0").gates.model_copy(update={"foam": None})
GATES = EXAM.model_copy(update={"conduct": None})
TABLE = GATES.model_dump(mode="json")


def gently(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"gates": GATES})


GENTLE = gently(load_protocol("bathing-v3"))
