"""The rows of a dataset, made of recorded trials in many processes, with pictures that a policy would have received.

States between two that a recording stores are stepped again (``replay.replay``), and each observation is built as in a
trial, with the trial's own noise and errors of calibration, but at any time and for any card.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from carecontact.episode.randomization import calibration, sensor_noise, with_draws_of
from carecontact.errors import RecordingError
from carecontact.interface.learned import cloud, square
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.recording import read_recording
from carecontact.recording.lerobot import Clip, Episode, Stream, histogram_of, rows_of
from carecontact.recording.schema import Recording
from carecontact.replay.film import begin_drawing, drawing_processes, write_mp4
from carecontact.replay.replay import STATE, Replay, ReplayQuality
from carecontact.scoring.foam import RecordedWiping
from carecontact.sensing.builder import ObservationBuilder
from carecontact.sensing.keypoints import PoseEstimator
from carecontact.sim.rendering import SceneRenderer

KEYFRAME_EVERY = {"g": "2"}
"""Option of x264: every second picture of a film is whole, so that any row is found in two steps. So does lerobot
(huggingface/lerobot 7427f318, src/lerobot/configs/video.py)."""
CLOUD = ("x", "y", "z", "red", "green", "blue")
"""Numbers of a point: place in base [m], and colour in [0, 1]."""


class Resensed:
    """A recorded trial as a policy with another card would have seen it."""

    def __init__(self, recording: Recording, card: PolicyCard) -> None:
        """Raises RecordingError, SceneError and SettleError as ``Replay``."""
        self._recording, self._card, self.quality = recording, card, ReplayQuality()
        self._replay = Replay(recording)

    def observations(self, hz: float) -> Iterator[Observation]:
        """Yield the observation at each k / hz from t = 0 until the last action has ended. Call it once."""
        spec, replay = self._recording.header.spec.opened, self._replay
        simulation, model = replay.simulation, replay.model
        protocol = with_draws_of(spec.protocol, simulation.protocol)
        wiping, foam, shown = RecordedWiping.of(self._recording), replay.scene.foam, None
        data = mujoco.MjData(model)
        known = calibration(protocol, spec.seed, salt=spec.salt)
        with SceneRenderer(model, protocol=protocol, calibration=known) as renderer:
            builder = ObservationBuilder(
                renderer,
                self._card,
                protocol,
                PoseEstimator(),
                noise=sensor_noise(protocol, spec.seed, salt=spec.salt, noise_salt=spec.noise_salt),
            )
            for stretch in replay.stretches(hz):
                self.quality.take(stretch)
                for step, state in zip(stretch.steps, stretch.states, strict=True):
                    if step == replay.step_count:
                        return
                    time_s = float(step) * replay.dt_s
                    if wiping is not None and foam is not None:
                        left = wiping.until(time_s).left
                        if shown is None or (left != shown).any():
                            shown = left.copy()
                            foam.paint(model, shown)
                            renderer.skin_changed()
                    mujoco.mj_setState(model, data, state, STATE)
                    mujoco.mj_kinematics(model, data)
                    mujoco.mj_comPos(model, data)
                    mujoco.mj_camlight(model, data)
                    yield builder.build(data, instruction=protocol.task(spec.task_id).prompt, sim_time_s=time_s)


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """How the rows of a dataset are made of a recording."""

    sizes: Mapping[str, int]
    """Camera -> side of its square picture [px]."""
    hz: float
    """Rows in a second."""
    film: bool = False
    """Whether the pictures become films."""
    points: int = 0
    """Number of points in each row, of the first camera; 0 leaves them out."""

    @property
    def card(self) -> PolicyCard:
        modalities = ("rgb", "depth") if self.points else ("rgb",)
        return PolicyCard(name="dataset", modalities=modalities, cameras=tuple(self.sizes))

    def episode(self, recording: Recording, *, success: bool, folder: Path) -> tuple[Episode, ReplayQuality]:
        """Return a trial's rows and pictures. Raises RecordingError for a trial without an action or whose states could
        only be guessed."""
        spec, resensed = recording.header.spec, Resensed(recording, self.card)
        rng = np.random.default_rng(spec.seed)
        bounds = spec.protocol.impedance.action_bounds
        pictures: dict[str, list[Any]] = {camera: [] for camera in self.sizes}
        rows: list[Observation] = []
        clouds: list[Any] = []
        for seen in resensed.observations(self.hz):
            for camera, size in self.sizes.items():
                pictures[camera].append(square(seen.cameras[camera].rgb, size))
            if self.points:
                clouds.append(cloud(seen.cameras[next(iter(self.sizes))], self.points, bounds, rng))
            rows.append(seen)
        if not rows or resensed.quality.kind == "interpolated":
            raise RecordingError(f"{spec.trial_id}: it cannot be stepped again here: {resensed.quality}")
        streams = rows_of(recording, rows, hz=self.hz, success=success)
        if self.points:
            streams["observation.points"] = Stream(names=CLOUD, values=np.array(clouds))
        fps, each = int(self.hz) if float(self.hz).is_integer() else self.hz, np.arange(len(rows))
        alike = {"instruction": rows[0].instruction, "fps": fps, "streams": streams}
        if not self.film:
            shown = dict.fromkeys(self.sizes, each)
            return Episode(**alike, images=pictures, shown=shown), resensed.quality
        clips: dict[str, Clip] = {}
        for camera, frames in pictures.items():
            path = folder / f"{spec.trial_id}-{camera}.mp4"
            write_mp4(path, frames, fps=fps, comment="", more=KEYFRAME_EVERY)
            clips[camera] = Clip(path=path, shape=frames[0].shape, histogram=histogram_of(frames, each))
        return Episode(**alike, clips=clips), resensed.quality


def rendered(
    run: Path, trials: Sequence[str], rendering: Rendering, *, passed: Sequence[str], jobs: int | None
) -> Iterator[tuple[str, Episode | str]]:
    """Yield each trial in order with its episode, or why it has none. Raises DependencyError."""
    with tempfile.TemporaryDirectory(prefix=".rendering-", dir=run) as folder:
        work = partial(_work, run=run, rendering=rendering, passed=frozenset(passed), folder=Path(folder))
        killed = "a process that renders was killed, perhaps for memory: try --jobs 1"
        with drawing_processes(jobs or _cores(), begin_drawing, killed=killed) as pool:
            yield from zip(trials, pool.map(work, trials), strict=True)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _work(trial_id: str, *, run: Path, rendering: Rendering, passed: frozenset[str], folder: Path) -> Episode | str:
    try:
        recording = read_recording(run / f"{trial_id}.h5")
        return rendering.episode(recording, success=trial_id in passed, folder=folder)[0]
    except RecordingError as error:
        return str(error)
