"""Collects a trial's streams in memory and turns them into a recording's arrays; knows no simulator and no policy."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from carecontact.contract.observation import Observation
from carecontact.errors import PolicyError
from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, empty_arrays

F64 = npt.NDArray[np.float64]
Arrays = dict[str, npt.NDArray[Any]]

MAX_LOSSLESS_FRAMES = 64
MAX_NOTES_BYTES = 32 << 20
MAX_STEP_NOTES, MAX_NOTES = 64, 4096
"""Most entries in the notes of one step, and most datasets in all notes of a trial: each takes milliseconds to write,
even if it is empty."""
STATE_PERIOD_S = 1.0

STREAMS = {
    "scorer/time_s": ("time_s", "<f8"),
    "scorer/force_human_from_robot_in_world": ("force", "<f4"),
    "scorer/normal_force": ("normal", "<f4"),
    "scorer/centroid_in_world": ("centroid", "<f4"),
    "scorer/human_joint_position": ("human_joint", "<f4"),
    "scorer/human_joint_reaction": ("human_reaction", "<f4"),
    "scorer/wrist_in_world": ("wrist", "<f4"),
    "scorer/pose_tcp_in_world": ("tcp_pose", "<f4"),
    "scorer/tcp_speed": ("tcp_speed", "<f4"),
    "scorer/tcp_rotation_speed": ("tcp_rotation_speed", "<f4"),
    "scorer/region_pose_in_world": ("region_pose", "<f4"),
}
"""Array of a recording -> field of ``Samples`` and dtype."""
BESIDE = {"scorer/beside_force_in_world": "beside_force", "scorer/beside_normal_force": "beside_normal"}
"""Array that only some recordings have -> field of ``Samples``, None where only the tip touched."""


class Samples(Protocol):
    """Sensor values with one entry for each physics step; STREAMS names the fields."""

    @property
    def time_s(self) -> F64: ...
    @property
    def beside_normal(self) -> F64 | None: ...


class TrialLog:
    """Collects the streams of one trial: every method adds rows. ``arrays`` may be called at any time."""

    def __init__(self, *, human_joints: int, regions: int, constants: Mapping[str, npt.NDArray[Any]]) -> None:
        """
        Args:
            human_joints: number of scored joints of the person.
            regions: number of the protocol's regions.
            constants: arrays that hold for the whole trial, by their path.
        """
        self._empty, self._constants = empty_arrays(human_joints, regions=regions), dict(constants)
        self._samples: list[Samples] = []
        self._periods: list[tuple[float, F64, F64]] = []
        self._cells: list[Mapping[str, F64]] = []
        self._observations: list[tuple[float, bytes]] = []
        self._actions: list[tuple[float, int, Mapping[str, F64]]] = []
        self._states: list[tuple[float, F64]] = []
        self._frames: Arrays = {}
        self._notes_bytes = self._notes_count = 0
        self.extra: Arrays = {}
        """Optional arrays, by their path."""

    def add_period(
        self,
        samples: Sequence[Samples],
        *,
        time_s: float,
        indentation_m: F64,
        target_in_base: F64,
        cells: Mapping[str, F64] | None = None,
    ) -> None:
        """Add one control period: its samples, and the values at its end, ``time_s``.

        Args:
            indentation_m: (R,) largest indentation of each region.
            target_in_base: (7,) position [m] and quat_wxyz of the impedance target.
            cells: array path -> further values of the period, such as what each cell felt in it (C,); a trial has the
                same paths in every period.
        """
        self._cells.append(cells or {})
        self._samples.extend(samples)
        self._periods.append((time_s, indentation_m, target_in_base))

    def wants_state(self, time_s: float) -> bool:
        """Whether STATE_PERIOD_S has passed since the last state."""
        return not self._states or time_s - self._states[-1][0] >= STATE_PERIOD_S - 1e-9

    def add_state(self, time_s: float, state: F64) -> None:
        """Add a state. ``state``: (n,) the simulator's integration state."""
        self._states.append((time_s, state))

    def add_observation(self, observation: Observation, sent_sha256: bytes) -> None:
        """Add the time of an observation. ``sent_sha256``: 32 bytes, the digest of the message that carried it."""
        self.add_frames(observation)
        self._observations.append((observation.sim_time_s, sent_sha256))

    def add_frames(self, observation: Observation) -> None:
        """Keep the images of the next observation. If the policy fails at that step, they are all that is kept of
        it.
        """
        index = len(self._observations)
        for name, view in observation.cameras.items():
            for modality in ("rgb", "depth"):
                image = getattr(view, modality)
                if image is not None and len(self._frames) < MAX_LOSSLESS_FRAMES:
                    self._frames[f"policy/frames/{index:04d}/{name}/{modality}"] = image

    def add_notes(self, notes: Mapping[str, object], *, failed: bool = False) -> None:
        """Keep the policy's notes on its latest step. ``failed``: whether the policy failed at that step.

        Raises:
            PolicyError: ``oversize`` for too many entries, arrays or bytes; ``garbage`` for what JSON cannot hold.
        """
        if not notes:
            return
        if len(notes) > MAX_STEP_NOTES:
            raise PolicyError("oversize", f"notes: expected at most {MAX_STEP_NOTES} entries a step, got {len(notes)}")
        place = f"policy/notes/{len(self._observations) - (not failed):04d}"
        arrays = {f"{place}/{key}": value for key, value in notes.items() if isinstance(value, np.ndarray)}
        if f"{place}/json" in arrays:
            raise PolicyError("garbage", "notes: an array is named 'json', which is the place of all that is no array")
        try:
            rest = {key: value for key, value in notes.items() if not isinstance(value, np.ndarray)}
            text = json.dumps(rest, sort_keys=True).encode()
        except (TypeError, ValueError) as error:
            raise PolicyError("garbage", f"notes: arrays belong at the top, the rest is JSON: {error}") from None
        self._notes_bytes += len(text) + sum(array.nbytes for array in arrays.values())
        if self._notes_bytes > MAX_NOTES_BYTES:
            raise PolicyError("oversize", f"notes of more than {MAX_NOTES_BYTES} bytes in one trial")
        self._notes_count += len(arrays) + 1
        if self._notes_count > MAX_NOTES:
            raise PolicyError("oversize", f"notes of more than {MAX_NOTES} arrays in one trial, one for a step's JSON")
        self.extra |= {**arrays, f"{place}/json": np.frombuffer(text, "u1")}

    def add_action(self, time_s: float, row: Mapping[str, F64]) -> None:
        """Add the action that became the target at ``time_s``.

        Args:
            row: array path -> its entry; the same paths at every action of a trial.
        """
        self._actions.append((time_s, len(self._observations) - 1, row))

    def _beside(self) -> Arrays:
        """Return what other parts of the robot than its tip did, if they touched the person at all."""
        given = next((s for s in self._samples if s.beside_normal is not None), None)
        if given is None:
            return {}
        out: Arrays = {}
        for path, field in BESIDE.items():
            shape = getattr(given, field).shape[1:]
            rows = [(len(s.time_s), getattr(s, field)) for s in self._samples]
            out[path] = np.concatenate([np.zeros((n, *shape)) if row is None else row for n, row in rows]).astype("<f4")
        return out

    def arrays(self) -> Arrays:
        """Return all arrays of the recording so far."""
        out = self._empty | self._constants
        for path, (field, dtype) in STREAMS.items():
            if self._samples:
                out[path] = np.concatenate([getattr(s, field) for s in self._samples]).astype(dtype)
        out |= self._beside()
        if self._periods:
            out["scorer/period_time_s"] = np.array([p[0] for p in self._periods], "<f8")
            out["scorer/indentation_m"] = np.array([p[1] for p in self._periods], "<f4")
            out["scorer/target_in_base"] = np.array([p[2] for p in self._periods], "<f4")
        for path in self._cells[0] if self._cells else ():
            out[path] = np.array([row[path] for row in self._cells], "<f4")
        if self._observations:
            digests = b"".join(sha256 for _, sha256 in self._observations)
            out["policy/observation_time_s"] = np.array([time_s for time_s, _ in self._observations], "<f8")
            out["policy/observation_sha256"] = np.frombuffer(digests, "u1").reshape(-1, 32)
        if self._actions:
            out["actions/time_s"] = np.array([a[0] for a in self._actions], "<f8")
            out["actions/observation_index"] = np.array([a[1] for a in self._actions], "<i4")
            for path in self._actions[0][2]:
                dtype, _ = ARRAYS.get(path) or OPTIONAL_ARRAYS[path]
                out[path] = np.array([a[2][path] for a in self._actions], f"<{dtype}")
        if self._states:
            out["state/time_s"] = np.array([s[0] for s in self._states], "<f8")
            out["state/integration"] = np.array([s[1] for s in self._states], "<f8")
        return out | self._frames | self.extra
