"""A synthetic recording with everything that the page of a trial shows."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from carecontact.recording.schema import SEGMENTS, EndReason, Failure, Recording
from tests.reports.synthetic_run import HOSTILE, make_recording, plateau
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
