"""What an episode records: forces, joints, poses, cells of the skin and the person's own movements at every step, how
it ended, and the header."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any
from typing import Protocol as TypingProtocol

import numpy as np
import numpy.typing as npt

from carecontact.episode.randomization import drawn_facts
from carecontact.errors import PolicyError
from carecontact.interface.observation import Observation
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import DECLARED, trial_versions
from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, SEGMENTS, EndReason, Failure, Header, empty_arrays
from carecontact.sim.simulation import Settled, Simulation
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256
from carecontact.tissue.plugin import Cells

# How an episode ends, and the forces at which the benchmark stops it.

STOPPED_OVER = 1.6
"""The robot stops itself above this multiple of the speed at which its target moves: 0.4 m/s where that is 0.25 m/s
(chosen). The impedance holds the tool to 1.1 times that speed, and a torque about the tool or what it touches adds to
that. With the declared 10 kg, 0.4 m/s are 0.8 J; a ball goes through the skin of a heavy abdomen from 0.91 J on."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    reason: EndReason
    failure: Failure | None = None
    """What went wrong; None where nothing did."""


class ForceCut:
    """Ends a trial as soon as any segment bears more than the protocol's multiple of its pain limit."""

    def __init__(self, protocol: Protocol) -> None:
        self._limit_n = np.array([protocol.phases.truncation_over_pain * protocol.f_pain(s) for s in SEGMENTS])

    def cut(self, force_n: npt.NDArray[np.float64]) -> Ended | None:
        """Return how the trial ends, or None while every force is allowed.

        ``force_n``: (n, S) magnitudes [N] of the forces on S segments in n steps.
        """
        over = force_n > self._limit_n
        if not over.any():
            return None
        step, segment = np.argwhere(over)[0]
        message = f"{force_n[step, segment]:.0f} N on {SEGMENTS[segment]}, cut at {self._limit_n[segment]:.0f} N"
        return Ended(reason="safety_truncation", failure=Failure(kind="force", message=message))


def cut_by_solver(warnings: list[str]) -> Ended | None:
    """Return how a trial with warnings of the solver ends; None without warnings.

    The sensor values of a period that diverged are no measurement.
    """
    if not warnings:
        return None
    failure = Failure(kind="solver", message=f"MuJoCo warning {', '.join(warnings)}")
    return Ended(reason="safety_truncation", failure=failure)


def cut_by_tool(speed_m_s: npt.NDArray[np.float64], protocol: Protocol) -> Ended | None:
    """Return how a trial ends in which a real robot would have stopped itself; None while the tool was slow enough.

    No period is recorded in which the tool was faster: a real robot stops at that moment (libfranka calls this
    ``cartesian_velocity_violation``), and what the tool does after it would be no measurement.

    Args:
        speed_m_s: (n,) of the tool in n steps.
    """
    limit, fastest = STOPPED_OVER * protocol.physics.max_tcp_speed_m_s, float(speed_m_s.max())
    if fastest <= limit:
        return None
    message = f"the tool moved at {fastest:.2f} m/s, and the robot stops itself above {limit:.2f} m/s"
    return Ended(reason="safety_truncation", failure=Failure(kind="tool_speed", message=message))


def cut_by_speed(fastest: tuple[int, float] | None) -> Ended | None:
    """Return how a trial ends in which a real robot would have stopped itself; None while no joint was too fast.

    Args:
        fastest: number of the fastest joint and its speed [rad/s]; None if no joint exceeded its limit.
    """
    if fastest is None:
        return None
    message = f"joint {fastest[0]} moved at {fastest[1]:.2f} rad/s, faster than the robot's controller allows"
    return Ended(reason="safety_truncation", failure=Failure(kind="joint_speed", message=message))


# The header of a trial's recording: what was run, on what, and how it ended.


def header_of(
    spec: TrialSpec,
    simulation: Simulation,
    settled: Settled,
    ended: Ended,
    *,
    model_sha256: str,
    card: dict[str, Any] | None,
    control: str | None,
    privileged: bool = False,
) -> Header:
    """Return the header of a recording.

    ``card``, ``control``: None if the policy never showed its card. ``privileged``: whether the policy was given the
    simulation.
    """
    warnings = simulation.solver_warnings()
    if simulation.normal_sum_truncated:
        warnings.append("normal-force sensor full: normal sums are too small")
    return Header(
        spec=spec,
        ended=ended.reason,
        failure=ended.failure,
        card=card,
        control=control,
        privileged=privileged,
        embodiment=simulation.robot.id,
        comfort_arm_deg=settled.comfort_arm_deg,
        segments=list(SEGMENTS),
        regions=list(spec.protocol.regions),
        human_joints=simulation.joint_names,
        pose_base_in_world=simulation.pose_base_in_world.tolist(),
        identity=DECLARED,
        versions=trial_versions(spec.protocol),
        sha256={
            "model": model_sha256,
            "body": simulation.scene.body.sha256,
            "robot": simulation.robot.source.sha256,
            "kernel": kernel_sha256(),
        },
        solver_warnings=warnings,
        drawn=drawn_facts(simulation.scene.protocol, simulation.scene.place)
        if spec.protocol.variation.draws_models
        else {},
    )


# What the declared cells of a trial's region felt in each control period, for its recording.

F64 = npt.NDArray[np.float64]
Rows = dict[str, F64]
SUMS = {f"scorer/cell_{field.name}": field.name for field in fields(Cells)}
"""Array of a recording -> field of ``Cells``."""


class CellLog:
    """Turns the running sums of the compiled tissue into the part of each control period; empty for a rigid region."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        """Begin the first period now."""
        self._simulation, self._region = simulation, region
        self._before = self._sums()

    def constants(self) -> dict[str, npt.NDArray[np.float32]]:
        """Return the centres (C, 3) [m] in the region's frame and the areas (C,) [m²] of the cells, by their path."""
        scene = self._simulation.scene
        if self._region not in scene.regions:
            return {}
        cells, frame = scene.regions[self._region].cells, scene.frames[self._region]
        return {
            "scorer/cell_in_region": ((cells.centres - frame.origin) @ frame.axes).astype("<f4"),
            "scorer/cell_area_m2": cells.areas.astype("<f4"),
        }

    def period(self) -> Rows:
        """Return what each cell (C,) felt since the last call, by the path of the array."""
        now = self._sums()
        added = {path: now[path] - self._before[path] for path in now}
        self._before = now
        return added

    def _sums(self) -> Rows:
        tissue = self._simulation.tissue.get(self._region)
        if tissue is None:
            return {}
        cells = tissue.cells(self._simulation.data)
        return {path: getattr(cells, name) for path, name in SUMS.items()}


# What the person of a trial did on their own, for the recording and never for the policy.


class LifeLog:
    """Collects the person's own movements. Every method returns arrays by their path; none if the person never moves on
    their own.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._life, self._data = simulation.life, simulation.data

    def constants(self) -> dict[str, npt.NDArray[Any]]:
        """Return when the arm moves to another place, and by how much, as it was drawn before the trial."""
        if self._life is None:
            return {}
        moves = self._life.moves()
        return {
            "scorer/repositioning_s": moves[:, 0].astype("<f8"),
            "scorer/repositioning_rad": moves[:, 1].astype("<f8"),
        }

    def period(self) -> dict[str, F64]:
        """Return the values at the end of a control period."""
        if self._life is None:
            return {}
        life, data = self._life, self._data
        return {
            "scorer/breath_m": life.breath_m(data), "scorer/muscle_torque_nm": life.torque_nm(data),
            "scorer/muscle_work_j": life.work_j(data),
        }  # fmt: skip

    def ended(self) -> dict[str, npt.NDArray[Any]]:
        """Return when the person withdrew the arm."""
        return {} if self._life is None else {"scorer/withdrawal_s": self._life.pulls_s(self._data).astype("<f8")}


# Collects a trial's streams in memory and turns them into a recording's arrays; knows no simulator and no policy.

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


class Samples(TypingProtocol):
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
