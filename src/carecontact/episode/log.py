"""Collects a trial's streams in memory and turns them into a recording's arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.errors import PolicyError
from carecontact.recording.schema import empty_arrays
from carecontact.sim.simulation import Samples, Settled, Simulation

MAX_LOSSLESS_FRAMES = 64
MAX_NOTES_BYTES = 32 << 20
MAX_STEP_NOTES, MAX_NOTES = 64, 4096
"""Entries of a step's notes, and datasets of all notes of a trial: each costs milliseconds to write, however empty."""
STATE_PERIOD_S = 1.0

_SCORER = {
    "scorer/time_s": ("time_s", "<f8"),
    "scorer/force_human_from_robot_in_world": ("force", "<f4"),
    "scorer/normal_force": ("normal", "<f4"),
    "scorer/centroid_in_world": ("centroid", "<f4"),
    "scorer/human_joint_position": ("human_joint", "<f4"),
    "scorer/wrist_in_world": ("wrist", "<f4"),
    "scorer/pose_tcp_in_world": ("tcp_pose", "<f4"),
    "scorer/tcp_speed": ("tcp_speed", "<f4"),
    "scorer/tcp_rotation_speed": ("tcp_rotation_speed", "<f4"),
    "scorer/region_pose_in_world": ("region_pose", "<f4"),
}


class TrialLog:
    def __init__(self, simulation: Simulation, settled: Settled) -> None:
        self._simulation, self._settled = simulation, settled
        self._samples: list[Samples] = []
        self._periods: list[tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]]] = []
        self._observations: list[tuple[float, bytes]] = []
        self._actions: list[tuple[float, npt.NDArray[np.float64], tuple[float, float], int]] = []
        self._states: list[tuple[float, npt.NDArray[np.float64]]] = []
        self._frames: dict[str, npt.NDArray[Any]] = {}
        self._notes_bytes = self._notes_count = 0
        self.extra: dict[str, npt.NDArray[Any]] = {}

    def add_samples(self, samples: list[Samples]) -> None:
        self._samples.extend(samples)
        now = self._simulation.time_s
        self._periods.append((now, self._simulation.indentation(), self._simulation.interpolator.pose))
        if not self._states or now - self._states[-1][0] >= STATE_PERIOD_S - 1e-9:
            self.add_state()

    def add_state(self) -> None:
        self._states.append((self._simulation.time_s, self._simulation.integration_state()))

    def add_observation(self, observation: Observation, sent_sha256: bytes) -> None:
        self.add_frames(observation)
        self._observations.append((observation.sim_time_s, sent_sha256))

    def add_frames(self, observation: Observation) -> None:
        """Of the observation that comes next; alone where the policy failed at that step."""
        index = len(self._observations)
        for name, view in observation.cameras.items():
            for modality in ("rgb", "depth"):
                image = getattr(view, modality)
                if image is not None and len(self._frames) < MAX_LOSSLESS_FRAMES:
                    self._frames[f"policy/frames/{index:04d}/{name}/{modality}"] = image

    def add_notes(self, notes: Mapping[str, object], *, failed: bool = False) -> None:
        """What the policy wants to be kept of its latest step, ``failed``: of the one that it failed at.

        Raises PolicyError for what no JSON can hold.
        """
        if not notes:
            return
        if len(notes) > MAX_STEP_NOTES:
            raise PolicyError("oversize", f"notes: expected at most {MAX_STEP_NOTES} entries a step, got {len(notes)}")
        place = f"policy/notes/{len(self._observations) - (not failed):04d}"
        arrays = {f"{place}/{key}": value for key, value in notes.items() if isinstance(value, np.ndarray)}
        try:
            rest = {key: value for key, value in notes.items() if not isinstance(value, np.ndarray)}
            text = json.dumps(rest, sort_keys=True).encode()
        except (TypeError, ValueError) as error:
            raise PolicyError("garbage", f"notes: arrays belong at the top, the rest is JSON: {error}") from None
        size = len(text) + sum(array.nbytes for array in arrays.values())
        self._notes_bytes += size
        if self._notes_bytes > MAX_NOTES_BYTES:
            raise PolicyError("oversize", f"notes of more than {MAX_NOTES_BYTES} bytes in one trial")
        self._notes_count += len(arrays) + 1
        if self._notes_count > MAX_NOTES:
            raise PolicyError("oversize", f"notes of more than {MAX_NOTES} arrays in one trial, one for a step's JSON")
        self.extra |= {**arrays, f"{place}/json": np.frombuffer(text, "u1")}

    def add_action(self, action: Action, stiffness: tuple[float, float]) -> None:
        pose = np.full(7, np.nan) if action.pose_tcp_in_base is None else action.pose_tcp_in_base
        self._actions.append((self._simulation.time_s, pose, stiffness, len(self._observations) - 1))

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        out = empty_arrays(len(self._simulation.joint_names))
        for path, (field, dtype) in _SCORER.items():
            if self._samples:
                out[path] = np.concatenate([getattr(s, field) for s in self._samples]).astype(dtype)
        shells = [self._simulation.scene.regions[r].shell for r in ("forearm", "upper_arm", "abdomen")]
        out |= {
            "scorer/human_joint_range": self._simulation.joint_range.astype("<f8"),
            "scorer/human_joint_settled": self._settled.joint_position.astype("<f8"),
            "scorer/wrist_settled_in_world": self._settled.wrist_in_world.astype("<f8"),
            "scorer/region_size_m": np.array([[s.length_m, s.radius_m, s.axis_depth_m] for s in shells], "<f8"),
        }
        if self._periods:
            out["scorer/period_time_s"] = np.array([p[0] for p in self._periods], "<f8")
            out["scorer/indentation_m"] = np.array([p[1] for p in self._periods], "<f4")
            out["scorer/target_in_base"] = np.array([p[2] for p in self._periods], "<f4")
        if self._observations:
            out["policy/observation_time_s"] = np.array([o[0] for o in self._observations], "<f8")
            out["policy/observation_sha256"] = np.frombuffer(b"".join(o[1] for o in self._observations), "u1").reshape(
                -1, 32
            )
        if self._actions:
            out["actions/time_s"] = np.array([a[0] for a in self._actions], "<f8")
            out["actions/pose_tcp_in_base"] = np.array([a[1] for a in self._actions], "<f8")
            out["actions/stiffness"] = np.array([a[2] for a in self._actions], "<f8")
            out["actions/observation_index"] = np.array([a[3] for a in self._actions], "<i4")
        if self._states:
            out["state/time_s"] = np.array([s[0] for s in self._states], "<f8")
            out["state/integration"] = np.array([s[1] for s in self._states], "<f8")
        return out | self._frames | self.extra
