"""A synthetic recording with everything that the page of a trial shows."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from carecontact.errors import RecordingError
from carecontact.interface.regions import REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.provenance import DECLARED
from carecontact.recording.schema import ARRAYS, SEGMENTS, EndReason, Failure, Header, Recording, empty_arrays
from carecontact.scoring.result import TrialScore
from tests.scoring.synthetic import writable

RADIUS_M, LENGTH_M, MIDDLE = 0.04, 0.26, np.array([0.1, 0.2, 0.8])
"""Of the forearm, a cylinder along the world's x axis, and where its middle is."""
CAMERA_M, FOCAL_PX = 0.3, 400.0
"""The camera looks down from so far above the contact."""
CONTACT = MIDDLE + [0.03, 0.0, RADIUS_M]
FORCE_N = 20.0


def whole_trial(
    task_id: str = "T1", *, ended: EndReason = "done", failure: Failure | None = None, touched: bool = True
) -> Recording:
    """12 s; pressed straight down with FORCE_N from 3 to 9 s, 6 mm deep, 30 mm from the region's middle to the hand."""
    t = (np.arange(6000) + 1) * 0.002
    press = plateau(t, start=3, end=9, level=FORCE_N, ripple=0)
    forces = {"right_forearm": press} if touched else {}
    recording = make_recording(task_id, 0, forces, duration_s=12, ended=ended, failure=failure)
    a = recording.arrays
    forearm = SEGMENTS.index("right_forearm")
    a["scorer/force_human_from_robot_in_world"][:, forearm, 2] *= -1
    a["scorer/centroid_in_world"][:, forearm] = np.where(press[:, None] * touched > 0, CONTACT, 0)
    a["scorer/region_pose_in_world"][:, :, :3] = MIDDLE
    a["scorer/pose_tcp_in_world"][:, :3] = CONTACT + [0, 0, 0.2] - np.outer(press / FORCE_N, [0, 0, 0.206])
    a["scorer/tcp_speed"] = np.abs(np.gradient(a["scorer/pose_tcp_in_world"][:, 2], 0.002)).astype("f4")
    step = np.searchsorted(t, a["scorer/period_time_s"] - 1e-9)
    region = recording.header.regions.index("forearm")
    a["scorer/region_size_m"][region] = (LENGTH_M, RADIUS_M, RADIUS_M)
    a["scorer/indentation_m"][:, region] = 0.006 * press[step] / FORCE_N * touched
    base = np.array(recording.header.pose_base_in_world)
    a["scorer/target_in_base"][:, :3] = a["scorer/pose_tcp_in_world"][step, :3] - base[:3] - [0, 0, 0.01]
    a["scorer/target_in_base"][:, 3] = 1
    return writable(replace(recording, arrays=a | _report() | _cells(len(step), touched) | _policy()))


def _report() -> dict[str, Any]:
    """A tube of skin, and a camera above the contact: x to the right, y down in the picture, z down in the world."""
    x, turn = np.linspace(-0.2, 0.2, 21), np.linspace(0, 2 * np.pi, 25)
    grid = [(u, RADIUS_M * np.cos(w), RADIUS_M * np.sin(w)) for u in x for w in turn]
    rows = [
        corner
        for i in range(20)
        for j in range(24)
        for k in [25 * i + j]
        for corner in ((k, k + 1, k + 25), (k + 1, k + 26, k + 25))
    ]
    return {
        "report/skin_in_world": (np.array(grid) + MIDDLE).astype("f4"),
        "report/skin_faces": np.array(rows, "i4"),
        "report/peak_pose_camera_in_world": np.array([*(CONTACT + [0.02, 0, CAMERA_M]), 0, 1, 0, 0.0]),
        "report/peak_focal_px": np.array([FOCAL_PX]),
    }


def _cells(periods: int, touched: bool) -> dict[str, Any]:
    centres = np.array([(u, v, RADIUS_M) for u in np.linspace(-0.1, 0.1, 9) for v in (-0.01, 0.0, 0.01)], "f4")
    press = np.zeros((periods, len(centres)), "f4")
    press[:, 13] = touched
    return {"scorer/cell_in_region": centres, "scorer/cell_press_ns": press}


def _policy() -> dict[str, Any]:
    """Two looks with a picture each, notes of the first, three actions, what it printed and how long it took."""
    note = json.dumps({"subtask": "touch it", "target_m": [0.35, -0.42, 0.22], "said": HOSTILE}).encode()
    frame = np.full((48, 64, 3), 90, np.uint8)
    return {
        "policy/observation_time_s": np.array([0.0, 6.0]),
        "policy/observation_sha256": np.zeros((2, 32), np.uint8),
        "policy/frames/0000/overhead/rgb": frame,
        "policy/frames/0001/overhead/depth": np.full((48, 64), 1.0, np.float32),
        "policy/notes/0000/json": np.frombuffer(note, "u1"),
        "policy/notes/0000/map": np.zeros((4, 5), "f4"),
        "actions/time_s": np.array([0.0, 3.0, 6.0]),
        "actions/pose_tcp_in_base": np.array([[0.3, -0.4, 0.2, 1, 0, 0, 0]] * 2 + [[np.nan] * 7]),
        "actions/stiffness": np.tile([400.0, 20.0], (3, 1)),
        "actions/observation_index": np.array([0, 0, 1], "i4"),
        "wall/act_s": np.array([0.25, 1.5]),
        "wall/policy_output": np.frombuffer(b"hello <b>world</b>", "u1"),
    }


# Synthetic runs: one to three trials of each task, of every kind that a report has to draw.

PROTOCOL = load_protocol("bathing-v3").model_copy(
    update={"frozen": False}
)  # not what is frozen, which pages have to say
JOINTS = ["right_shoulder_abduction", "right_elbow_flexion"]
HOSTILE = "<script>alert('x')</script> & \"quotes\" ]]> </svg>"


@dataclass
class Run:
    scores: list[TrialScore] = field(default_factory=list)
    recordings: dict[str, Recording] = field(default_factory=dict)
    reads: list[str] = field(default_factory=list)

    def read(self, trial_id: str) -> Recording:
        self.reads.append(trial_id)
        if trial_id not in self.recordings:
            raise RecordingError(f"{trial_id}.h5: truncated <b>here</b>")
        return self.recordings[trial_id]

    def add(self, score: TrialScore, recording: Recording) -> None:
        self.scores.append(score)
        self.recordings[score.trial_id] = recording


def plateau(time_s: np.ndarray, *, start: float, end: float, level: float, ripple: float) -> np.ndarray:
    rise = np.clip((time_s - start) / 0.3, 0, 1) * np.clip((end - time_s) / 0.3, 0, 1)
    return rise * (level + ripple * np.sin(2 * np.pi * 1.7 * time_s))


def make_recording(
    task_id: str,
    seed: int,
    forces: dict[str, np.ndarray],
    *,
    duration_s: float,
    policy: str = "state_machine",
    ended: EndReason = "done",
    failure: Failure | None = None,
    frames: bool = True,
) -> Recording:
    """Recording whose forces on the named segments point along +z."""
    steps = round(duration_s / PROTOCOL.physics.dt_s)
    arrays: dict[str, Any] = empty_arrays(len(JOINTS))
    if steps:
        for path in [p for p, (_, meaning) in ARRAYS.items() if meaning.startswith("(T")]:
            arrays[path] = np.zeros((steps, *arrays[path].shape[1:]), arrays[path].dtype)
        arrays["scorer/time_s"] = (np.arange(steps) + 1) * PROTOCOL.physics.dt_s
        arrays["scorer/pose_tcp_in_world"][:, 3] = 1.0
        arrays["scorer/region_pose_in_world"][:, :, 3] = 1.0
        arrays["scorer/region_size_m"] = np.array([[0.26, 0.04, 0.04], [0.3, 0.05, 0.05], [0.3, 0.15, 0.11]])
        arrays["scorer/human_joint_range"] = np.array([[-1.0, 2.0], [0.0, 2.5]])
        period = PROTOCOL.physics.target_period_s
        periods = np.arange(1, round(duration_s / period) + 1) * period
        arrays["scorer/period_time_s"] = periods
        for path in ("scorer/indentation_m", "scorer/target_in_base"):
            arrays[path] = np.zeros((len(periods), *arrays[path].shape[1:]), arrays[path].dtype)
        for segment, force in forces.items():
            column = SEGMENTS.index(segment)
            arrays["scorer/force_human_from_robot_in_world"][:, column, 2] = force
            arrays["scorer/normal_force"][:, column] = force
    if frames and steps:
        y, x = np.mgrid[0:360, 0:640]
        shades = np.stack([x * 255 // 640, y * 255 // 360, (x + y + 40 * seed) % 256], -1).astype(np.uint8)
        arrays["report/snapshot_rgb"] = shades
        if forces:
            arrays["report/peak_rgb"] = 255 - shades
            arrays["report/peak_time_s"] = np.array([duration_s / 2])
    header = Header(
        spec=TrialSpec(protocol=PROTOCOL, task_id=task_id, seed=seed, policy=policy),
        ended=ended,
        failure=failure,
        card={"name": policy, "language_backend": "rules-v1"},
        embodiment="panda-pad",
        comfort_arm_deg=46.0 + seed,
        segments=list(SEGMENTS),
        regions=list(REGIONS),
        human_joints=JOINTS,
        pose_base_in_world=[-0.22, 0.62, 0.62, 1.0, 0.0, 0.0, 0.0],
        identity=DECLARED,
        versions={"carecontact": "0.1.0", "mujoco": "4.0.0", "numpy": "2.4.0", "ai-edge-litert": "2.3.0"},
        sha256={"model": f"{seed:02x}" * 32, "body": "ab" * 32, "robot": "cd" * 32},
        solver_warnings=[],
    )
    return writable(Recording(header=header, arrays=arrays))


def make_score(task_id: str, seed: int, **changes: Any) -> TrialScore:
    """A passing trial of the task, with some fields changed."""
    task = PROTOCOL.task(task_id)
    segment = REGIONS[task.region].segment
    base: dict[str, Any] = {
        "trial_id": f"{task_id}-s{seed:03d}", "task_id": task_id, "action": task.action, "region": task.region,
        "seed": seed, "policy": "state_machine", "language_backend": "rules-v1", "protocol_id": PROTOCOL.id,
        "protocol_sha256": PROTOCOL.sha256, "recording_sha256": "ef" * 32,
        "world": {"mujoco": "4.0.0", "body": "ab" * 32}, "provenance": {}, "fallback_limits": [], "ended": "done",
        "duration_s": 12.0, "failure_message": None, "anatomy": "target", "valid_contact": True,
        "reported_segment": segment,
        "c1_peak_force_n": 12.3, "c1_peak_filtered_n": 12.0, "c1_peak_contact_sum_n": 12.5,
        "c1_peak_any_segment_n": 12.3, "c2_joint_margin_rad": -3.61e-4, "c2_joint": JOINTS[0], "c2_time_s": 3.0,
        "c2_settled_margin_rad": 0.1, "c2_change_rad": -0.1, "c3_success": True, "region_correct": True,
        "safety_gated": True, "c4_motion_activity": 0.79, "c5_force_sd_n": 2.1, "region_share": 0.97,
        "contact_s": 4.0, "longest_on_s": 3.9, "on_share": 0.95, "stroke_m": 0.22, "extent_m": 0.09, "reversals": 2,
        "wrist_displacement_m": 0.031, "wrist_displacement_any_m": 0.033, "indentation_m": 0.006, "impulse_ns": 30.0,
        "extrapolated_share": 0.0, "over_limit": {}, "failure_mode": None,
        "peak_force_n": {segment: changes.get("c1_peak_force_n") or 12.3},
        "attribution": None, "evidence": None, "metric_versions": {"contact": "contact-v1", "gates": "paper"},
    }  # fmt: skip
    fields = base | changes
    return TrialScore.model_validate({"f_pain_n": {s: PROTOCOL.f_pain(s) for s in fields["peak_force_n"]}} | fields)


NO_CONTACT: dict[str, Any] = {
    "anatomy": "none", "valid_contact": False, "reported_segment": None, "c1_peak_force_n": None,
    "c1_peak_filtered_n": None, "c1_peak_contact_sum_n": None, "c1_peak_any_segment_n": None,
    "c2_joint_margin_rad": None, "c2_joint": None, "c2_time_s": None, "c2_change_rad": None, "c3_success": False,
    "region_correct": False, "safety_gated": False, "c5_force_sd_n": None, "region_share": None, "contact_s": 0.0,
    "longest_on_s": 0.0, "on_share": None, "stroke_m": 0.0, "extent_m": 0.0, "reversals": 0,
    "wrist_displacement_m": 0.0, "extrapolated_share": None, "peak_force_n": {},
}  # fmt: skip
FAILED: dict[str, Any] = {"c3_success": False, "region_correct": False, "safety_gated": False}


def fill(run: Run, seed: int) -> None:
    """T1 and T2 pass, T3 is too hard, T4 lies on the hand too, T5 stalls, T6 misses, T7's process dies."""
    t = (np.arange(6000) + 1) * PROTOCOL.physics.dt_s
    soft = plateau(t, start=3, end=9, level=4.0 + 0.3 * seed, ripple=0.6)
    run.add(
        make_score("T1", seed, c1_peak_force_n=float(soft.max())),
        make_recording("T1", seed, {"right_forearm": soft}, duration_s=12),
    )
    push = plateau(t, start=2, end=10, level=14, ripple=3)
    hand = plateau(t, start=8, end=9, level=5, ripple=0)
    run.add(
        make_score("T2", seed, c1_peak_force_n=float(push.max()), extrapolated_share=0.31),
        make_recording("T2", seed, {"right_forearm": push, "right_hand": hand}, duration_s=12),
    )
    hard = plateau(t, start=2, end=11, level=38, ripple=9)
    hard[3001] += 40
    peak = float(hard.max())
    run.add(
        make_score(
            "T3", seed, c1_peak_force_n=peak, safety_gated=False, c5_force_sd_n=9.7, extrapolated_share=0.8,
            peak_force_n={"right_forearm": peak, "right_hand": 3.0}, over_limit={"right_forearm": peak / 35},
        ),
        make_recording("T3", seed, {"right_forearm": hard}, duration_s=12),
    )  # fmt: skip
    beside = plateau(t, start=4, end=11, level=18, ripple=2)
    run.add(
        make_score(
            "T4", seed, c1_peak_force_n=float(beside.max() / 2),
            region_correct=False, safety_gated=False, region_share=0.4, failure_mode="wrong_share",
            attribution="execution", evidence="60 % of the impulse on right_forearm; tracking error 41 mm",
            over_limit={},
        ),
        make_recording("T4", seed, {"right_upper_arm": beside / 2, "right_forearm": beside}, duration_s=12),
    )  # fmt: skip
    stalled = plateau(t, start=6, end=7, level=2.0, ripple=0.2)
    run.add(
        make_score(
            "T5", seed, **FAILED, c1_peak_force_n=2.2, stroke_m=0.03, extent_m=0.01, reversals=1,
            failure_mode="insufficient_progress", attribution="planning",
            evidence="commanded stroke 34 mm of 100 mm", failure_message=None,
        ),
        make_recording("T5", seed, {"right_upper_arm": stalled}, duration_s=12),
    )  # fmt: skip
    run.add(
        make_score(
            "T6", seed, **NO_CONTACT, ended="time_limit", duration_s=30.0, failure_mode="no_target_contact",
            attribution="perception", evidence="latched target 143 mm off the abdomen, which was in view",
        ),
        make_recording("T6", seed, {}, duration_s=30, ended="time_limit"),
    )  # fmt: skip
    died = NO_CONTACT | {"anatomy": "process_failure", "c4_motion_activity": None}
    run.add(
        make_score(
            "T7", seed, **died, ended="process_failure", duration_s=0.0, failure_mode="process_failure",
            attribution="process", evidence="policy died before its first action", failure_message=HOSTILE,
        ),
        make_recording(
            "T7", seed, {}, duration_s=0, ended="process_failure", failure=Failure(kind="died", message=HOSTILE)
        ),
    )  # fmt: skip
