"""The probes' sweeps as the simulator made them, kept so that tests of wrong metrics need no simulator.

``python -m tests.lab.validation.stored_sweeps`` from the repository's root makes them again (minutes); do so when a
script of the probes changes. Kept is what C1 to C5 and the tests' wrong metrics read, rounded to float32.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.lab.validation.probes import PROBES, Probe, Trial, sweep
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.load import load_protocol
from carecontact.recording.provenance import DECLARED
from carecontact.recording.schema import SCHEMA_VERSION, SEGMENTS, Header, Recording

FOLDER = Path(__file__).parent / "sweeps"
FORCE, NORMAL = "scorer/force_human_from_robot_in_world", "scorer/normal_force"
JOINT, RANGE, SETTLED = (f"scorer/human_joint_{name}" for name in ("position", "range", "settled"))
POSE, SPEED, ROTATION = "scorer/pose_tcp_in_world", "scorer/tcp_speed", "scorer/tcp_rotation_speed"
NEAR_END_RAD = 0.3
"""Joints that never came that near to an end are kept at their settled angle."""


def read_sweep(metric: str) -> list[Trial]:
    probe = PROBES[metric]
    with np.load(FOLDER / f"{metric}.npz") as stored:
        header = Header.model_validate({
            **json.loads(stored["header"].tobytes()), "schema_version": SCHEMA_VERSION, "identity": DECLARED,
        })  # fmt: skip
        assert stored["levels"].tolist() == list(probe.levels), "the levels changed: make the sweeps again"
        held = [str(name) for name in stored["held_names"]]
        return [
            Trial(
                recording=_recording(header, {name: stored[f"{k}/{name}"] for name in NAMES}, stored, probe),
                known=float(stored["known"][k]),
                held=dict(zip(held, stored["held"][k].tolist(), strict=True)),
            )
            for k in range(len(probe.levels))
        ]


NAMES = ("force", "normal", "joints", "height", "speed", "rotation")


def _recording(header: Header, kept: dict[str, np.ndarray], stored: np.lib.npyio.NpzFile, probe: Probe) -> Recording:
    column, count = SEGMENTS.index(REGIONS[probe.region].segment), len(kept["speed"])
    force, normal = np.zeros((count, len(SEGMENTS), 3), np.float32), np.zeros((count, len(SEGMENTS)), np.float32)
    force[:, column], normal[:, column] = kept["force"], kept["normal"]
    joints = np.tile(stored["settled"], (count, 1))
    joints[:, stored["moving"]] = kept["joints"]
    pose = np.zeros((count, 7))
    pose[:, 2], pose[:, 3] = kept["height"], 1.0
    region_pose = np.zeros((count, len(STANDARD_REGIONS), 7))
    region_pose[..., 3] = 1.0
    return Recording.trusted(
        header,
        {
            "scorer/time_s": np.arange(count) * header.spec.protocol.physics.dt_s, FORCE: force, NORMAL: normal,
            JOINT: joints, RANGE: stored["range"], SETTLED: stored["settled"], POSE: pose, SPEED: kept["speed"],
            ROTATION: kept["rotation"], "scorer/region_pose_in_world": region_pose,
            "scorer/region_size_m": np.full((len(STANDARD_REGIONS), 3), 0.1),
        },
    )  # fmt: skip


def store(probe: Probe, trials: list[Trial]) -> None:
    first = trials[0].recording
    column, low, high = SEGMENTS.index(REGIONS[probe.region].segment), *first[RANGE].T
    nearest = np.min([np.minimum(t.recording[JOINT] - low, high - t.recording[JOINT]).min(axis=0) for t in trials], 0)
    moving = np.flatnonzero(nearest < NEAR_END_RAD) if probe.metric == "C2@1" else np.array([], int)
    kept: dict[str, np.ndarray] = {}
    for k, trial in enumerate(trials):
        recording = trial.recording
        touched = np.flatnonzero((recording[NORMAL] > 0).any(axis=0))
        assert set(touched.tolist()) <= {column}, "another segment was touched"
        kept |= {
            f"{k}/force": recording[FORCE][:, column], f"{k}/normal": recording[NORMAL][:, column],
            f"{k}/joints": recording[JOINT][:, moving], f"{k}/height": recording[POSE][:, 2],
            f"{k}/speed": recording[SPEED], f"{k}/rotation": recording[ROTATION],
        }  # fmt: skip
    held = list(trials[0].held)
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(
        FOLDER / f"{probe.metric}.npz", allow_pickle=False,
        header=np.frombuffer(first.header.model_dump_json().encode(), np.uint8), levels=np.array(probe.levels),
        known=np.array([t.known for t in trials]), held_names=np.array(held), moving=moving, range=first[RANGE],
        held=np.array([[t.held[name] for name in held] for t in trials]), settled=first[SETTLED],
        **{name: np.round(array.astype(np.float32), 5) for name, array in kept.items()},
    )  # fmt: skip


def main() -> None:
    subject = Subject(load_protocol("bathing-v3"))
    for probe in PROBES.values():
        store(probe, sweep(subject, probe))


if __name__ == "__main__":
    main()
