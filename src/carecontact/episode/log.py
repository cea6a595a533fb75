"""What an episode records: forces, joints and poses at every step, what the person felt and did in each control period,
observations, notes and actions."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import PolicyError
from carecontact.human.foam import FoamPatch
from carecontact.interface.geometry import quat_from_matrix
from carecontact.interface.observation import Observation
from carecontact.recording.pictures import KEPT, PictureLog
from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, SEGMENTS, empty_arrays
from carecontact.scoring.foam import ENDS_S, FELT, SHARE, new_wiping, share_of_tool
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Samples, Settled, Simulation
from carecontact.tissue.plugin import Cells, Law

Arrays = dict[str, npt.NDArray[Any]]

STOPPED_OVER = 1.6
"""The robot stops itself above this multiple of the speed at which its target moves: 0.4 m/s where that is 0.25 m/s
(chosen). The impedance holds the tool to 1.1 times that speed, and a torque about the tool or what it touches adds to
that. With the declared 10 kg, 0.4 m/s are 0.8 J; a ball goes through the skin of a heavy abdomen from 0.91 J on."""
MAX_NOTES_BYTES = 32 << 20
MAX_STEP_NOTES, MAX_NOTES = 64, 4096
"""Most entries in the notes of one step, and most datasets in all notes of a trial: each takes milliseconds to write,
even if it is empty."""
STATE_PERIOD_S = 1.0
SUMS = {f"scorer/cell_{field.name}": field.name for field in fields(Cells)}
"""Array of a recording -> field of ``Cells``."""
STREAMS = {
    "scorer/time_s": "time_s",
    "scorer/force_human_from_robot_in_world": "force",
    "scorer/normal_force": "normal",
    "scorer/centroid_in_world": "centroid",
    "scorer/human_joint_position": "human_joint",
    "scorer/human_joint_reaction": "human_reaction",
    "scorer/wrist_in_world": "wrist",
    "scorer/pose_tcp_in_world": "tcp_pose",
    "scorer/tcp_speed": "tcp_speed",
    "scorer/tcp_rotation_speed": "tcp_rotation_speed",
    "scorer/region_pose_in_world": "region_pose",
}
"""Array of a recording -> field of ``Samples``."""
BESIDE = {"scorer/beside_force_in_world": "beside_force", "scorer/beside_normal_force": "beside_normal"}
"""Array that only some recordings have -> field of ``Samples``, None where only the tip touched."""


class PersonLog:
    """What the person felt on the region's cells, none on a rigid one, and how they moved on their own, if at all."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        """Begin the first period now."""
        self._simulation, self._region, self._life = simulation, region, simulation.life
        self._before = self._sums()

    def constants(self, settled: Settled) -> Arrays:
        """Return what holds for the whole trial."""
        scene = self._simulation.scene
        out = {
            "scorer/human_joint_range": self._simulation.joint_range.astype("<f8"),
            "scorer/human_joint_settled": settled.joint_position.astype("<f8"),
            "scorer/wrist_settled_in_world": settled.wrist_in_world.astype("<f8"),
            "scorer/region_size_m": scene.region_size_m.astype("<f8"),
            **_own_law(self._simulation),
        }
        if self._region in scene.regions:
            cells, frame = scene.regions[self._region].cells, scene.frames[self._region]
            out["scorer/cell_in_region"] = ((cells.centres - frame.origin) @ frame.axes).astype("<f4")
            out["scorer/cell_area_m2"] = cells.areas.astype("<f4")
            if (patch := scene.foam) is not None:
                out["scorer/foam_pose_in_region"] = np.concatenate([patch.middle, quat_from_matrix(patch.axes)])
                out["scorer/foam_half_m"] = np.array(patch.half_m, "<f8")
                out[SHARE] = patch.cell_share.astype("<f4")
        if self._life is not None:
            moves = self._life.moves()
            out["scorer/repositioning_s"] = moves[:, 0].astype("<f8")
            out["scorer/repositioning_rad"] = moves[:, 1].astype("<f8")
        return out

    def period(self) -> Arrays:
        """Return what each cell (C,) felt since the last call, and the movements at the end of the control period."""
        now = self._sums()
        out = {path: now[path] - self._before[path] for path in now}
        self._before = now
        if self._life is not None:
            data = self._simulation.data
            out["scorer/breath_m"] = self._life.breath_m(data)
            out["scorer/muscle_torque_nm"] = self._life.torque_nm(data)
            out["scorer/muscle_work_j"] = self._life.work_j(data)
        return out

    def ended(self) -> Arrays:
        """Return when the person withdrew the arm."""
        if self._life is None:
            return {}
        return {"scorer/withdrawal_s": self._life.pulls_s(self._simulation.data).astype("<f8")}

    def _sums(self) -> Arrays:
        """Return the sums over time since the state was last reset."""
        tissue = self._simulation.tissue.get(self._region)
        if tissue is None:
            return {}
        cells = tissue.cells(self._simulation.data)
        return {path: getattr(cells, name) for path, name in SUMS.items()}


def _own_law(simulation: Simulation) -> Arrays:
    """Return the compiled laws if any differs from its row in the protocol: by the body's build or as drawn."""
    rows = simulation.protocol.person.tissue
    law = np.zeros((len(simulation.protocol.regions), len(fields(Law))))
    declared = law.copy()
    for at, name in enumerate(simulation.protocol.regions):
        if name in simulation.scene.regions:
            law[at] = simulation.model.numeric(f"{name}/law").data
            declared[at] = astuple(Law.of(rows[name]))
    return {} if np.array_equal(law, declared) else {"scorer/region_law": law.astype("<f8")}


class Foam:
    """The foam of one trial. It changes when the policy looks, and at no other time."""

    def __init__(self, simulation: Simulation, target: int, constants: Arrays, renderer: SceneRenderer) -> None:
        """Put all foam back onto a world at t = 0. ``target``: column of the named region's segment."""
        self._model, self._patch, self._target = simulation.model, simulation.scene.foam, target
        self._wiping, self._renderer = new_wiping(constants), renderer
        self._before_s, self._touched = 0.0, False
        if self._patch is not None:
            self._shown = np.ones(len(self._patch.cell_share))
            self._paint(self._patch)

    @property
    def present(self) -> bool:
        """Whether there is any foam."""
        return self._wiping is not None

    def add(self, time_s: float, samples: list[Samples], felt: Arrays) -> None:
        """Add the control period that ends at ``time_s``. ``felt``: what its row of the recording says of the cells."""
        if self._wiping is None:
            return
        # As the recording holds them, so that the scorer finds the same from it.
        mine = [(s.normal[:, self._target], s.beside_normal) for s in samples]
        normal = np.concatenate([normal for normal, _ in mine]).astype(np.float32)
        beside = [np.zeros((len(own), 2)) if b is None else b[..., self._target] for own, b in mine]
        press, slip, touch = (felt[path].astype(np.float32).astype(np.float64) for path in FELT)
        share = share_of_tool(normal, np.concatenate(beside).astype(np.float32))
        period_s, self._before_s = time_s - self._before_s, time_s
        self._touched |= self._wiping.add(period_s, press_ns=press, slip_m3=slip, touch_m2s=touch, tool_share=share)

    def show(self) -> None:
        """Paint what is left for the next pictures, where that has changed since the last look."""
        if self._wiping is None or self._patch is None or not self._touched:
            return
        left, self._touched = self._wiping.left, False
        if not np.array_equal(left, self._shown):
            self._shown = left
            self._paint(self._patch)

    def _paint(self, patch: FoamPatch) -> None:
        patch.paint(self._model, self._shown)
        self._renderer.skin_changed()


class TrialLog:
    """Collects the streams of one trial in memory; ``arrays`` may be called at any time."""

    def __init__(self, *, human_joints: int, regions: int, constants: Mapping[str, npt.NDArray[Any]]) -> None:
        """``constants``: arrays that hold for the whole trial, by their path."""
        self._fixed = {**empty_arrays(human_joints, regions=regions), **constants}
        self._samples: list[Samples] = []
        self._rows: defaultdict[str, list[Any]] = defaultdict(list)
        """Array path -> its rows so far."""
        self._observations = self._notes_bytes = self._notes_count = 0
        self._pictures = PictureLog()
        self._grown, self._seen = dict[str, _Grown](), 0
        self.extra: Arrays = {}
        """Optional arrays, by their path."""

    def add_period(self, samples: Sequence[Samples], row: Mapping[str, object]) -> None:
        """Add the samples of a control period and its row (array path -> value), with the same paths every time."""
        self._samples.extend(samples)
        self._add(row)

    def wants_state(self, time_s: float) -> bool:
        """Whether STATE_PERIOD_S has passed since the last state."""
        times = self._rows["state/time_s"]
        return not times or time_s - times[-1] >= STATE_PERIOD_S - 1e-9

    def add_state(self, time_s: float, state: npt.NDArray[np.float64]) -> None:
        """Add a state. ``state``: (n,) the simulator's integration state."""
        self._add({"state/time_s": time_s, "state/integration": state})

    def add_observation(
        self, observation: Observation, sent_sha256: bytes, *, looked: npt.NDArray[np.uint8] | None = None
    ) -> None:
        """Add an observation, which holds new views only. ``looked``: (V,) which cameras took one; None: all."""
        self.add_frames(observation)
        self._observations += 1
        digest = np.frombuffer(sent_sha256, "u1")
        self._add({"policy/observation_time_s": observation.sim_time_s, "policy/observation_sha256": digest})
        if looked is not None:
            self._add({"policy/looked": looked})

    def add_frames(self, observation: Observation) -> None:
        """Keep the images of the next observation: all that is kept of it if the policy fails at that step."""
        for name, view in observation.cameras.items():
            for modality in KEPT:
                if (picture := getattr(view, modality)) is not None:
                    self._pictures.add(self._observations, name, modality, picture)

    def add_notes(self, notes: Mapping[str, object], *, failed: bool = False) -> None:
        """Keep the notes on the latest step. Raises PolicyError for too many entries or bytes, or for what JSON cannot
        hold."""
        if not notes:
            return
        if len(notes) > MAX_STEP_NOTES:
            raise PolicyError("oversize", f"notes: expected at most {MAX_STEP_NOTES} entries a step, got {len(notes)}")
        place = f"policy/notes/{self._observations - (not failed):04d}"
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

    def add_action(self, time_s: float, row: Mapping[str, object]) -> None:
        """Add the action that became the target at ``time_s``, with the same paths at every action of a trial."""
        self._add({"actions/time_s": time_s, "actions/observation_index": self._observations - 1, **row})

    def _add(self, row: Mapping[str, object]) -> None:
        for path, value in row.items():
            self._rows[path].append(value)

    def arrays(self) -> Arrays:
        """Return all arrays of the recording so far."""
        out = self.measured(STREAMS)
        out |= {path: np.array(rows, _dtype(path)) for path, rows in self._rows.items() if rows}
        return out | self.extra | self._pictures.arrays()

    def measured(self, paths: Iterable[str]) -> Arrays:
        """Return these arrays of STREAMS so far, those of BESIDE, what holds for the whole trial, and where there is
        foam, what wiping it follows from. Of STREAMS, what was there at the last call is not gathered again."""
        if self._samples:
            beside = any(sample.beside_normal is not None for sample in self._samples[self._seen :])
            self._seen = len(self._samples)
            for path in paths:
                self._grown.setdefault(path, _Grown(path, STREAMS[path])).extend(self._samples)
            for path, name in BESIDE.items():
                if beside or path in self._grown:
                    self._grown.setdefault(path, _Grown(path, name)).extend(self._samples)
        wiped = (ENDS_S, *FELT) if SHARE in self._fixed else ()
        rows = {path: np.array(self._rows[path], _dtype(path)) for path in wiped if self._rows[path]}
        return self._fixed | {path: grown.rows for path, grown in self._grown.items()} | rows

    @property
    def measures(self) -> bool:
        """Whether there is any sample."""
        return bool(self._samples)

    def mean_force(self, steps: int) -> npt.NDArray[np.float64]:
        """Return the mean force (S, 3) [N] of the last physics steps, or of all where there are fewer."""
        total, left = np.zeros((len(SEGMENTS), 3)), steps
        for sample in reversed(self._samples):
            taken = sample.force[-left:]
            total, left = total + taken.sum(0), left - len(taken)
            if left <= 0:
                break
        return total / max(1, steps - left)


class _Grown:
    """One stream in an array that doubles when it is full."""

    def __init__(self, path: str, name: str) -> None:
        """``name``: field of ``Samples``."""
        self._path, self._name, self._taken, self._count = path, name, 0, 0
        self._array: npt.NDArray[Any] | None = None

    @property
    def rows(self) -> npt.NDArray[Any]:
        assert self._array is not None
        return self._array[: self._count]

    def extend(self, samples: Sequence[Samples]) -> None:
        """Add those that came since the last call. A field that is None stands for zeros."""
        blocks = [(len(s.time_s), getattr(s, self._name)) for s in samples[self._taken :]]
        self._taken = len(samples)
        end = self._count + sum(length for length, _ in blocks)
        if self._array is None:
            shape = next(block.shape[1:] for _, block in blocks if block is not None)
            self._array = np.zeros((end, *shape), _dtype(self._path))
        elif end > len(self._array):
            wider = np.zeros((2 * end, *self._array.shape[1:]), self._array.dtype)
            wider[: self._count] = self._array[: self._count]
            self._array = wider
        for length, block in blocks:
            if block is not None:
                self._array[self._count : self._count + length] = block
            self._count += length


def _dtype(path: str) -> str:
    dtype, _ = ARRAYS.get(path) or OPTIONAL_ARRAYS[path]
    return f"<{dtype}"
