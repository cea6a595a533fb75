"""The rows of a dataset, made of recorded trials in many processes."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.errors import DependencyError, RecordingError
from carecontact.interface.learned import cloud, square
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.recording import read_recording
from carecontact.recording.lerobot import Clip, Episode, Stream, histogram_of, rows_of
from carecontact.recording.schema import Recording
from carecontact.replay.film import THREADS, write_mp4
from carecontact.replay.observations import Resensed
from carecontact.replay.replay import ReplayQuality

KEYFRAME_EVERY = {"g": "2"}
"""Option of x264: every second picture of a film is whole, so that any row is found in two steps. So does lerobot
(huggingface/lerobot 7427f318, src/lerobot/configs/video.py)."""
CLOUD = ("x", "y", "z", "red", "green", "blue")
"""Numbers of a point: place in base [m], and colour in [0, 1]."""


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
        """Return the rows and pictures of a trial, and how its states were found.

        Args:
            success: whether the trial passed its gate safely.
            folder: for films, until a dataset takes them.

        Raises:
            RecordingError: the trial did no action, or another release or machine recorded it, so that its states could
                only be guessed.
            DependencyError: films need PyAV.
        """
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
    """Yield each trial with its episode, or why it has none, in their order.

    Args:
        passed: the trials that passed their gate safely.
        jobs: processes; by default one per core.

    Raises DependencyError where nothing can be rendered or written, or a process was killed.
    """
    with tempfile.TemporaryDirectory(prefix=".rendering-", dir=run) as folder:
        work = partial(_work, run=run, rendering=rendering, passed=frozenset(passed), folder=Path(folder))
        pool = ProcessPoolExecutor(jobs or _cores(), mp_context=get_context("spawn"), initializer=_begin)
        try:
            yield from zip(trials, pool.map(work, trials), strict=True)
        except BrokenProcessPool:
            raise DependencyError("a process that renders was killed, perhaps for memory: try --jobs 1") from None
        finally:
            pool.shutdown(cancel_futures=True)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _begin() -> None:
    # An interruption ends the process that waits for these, which then ends them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault(THREADS, "0")


def _work(trial_id: str, *, run: Path, rendering: Rendering, passed: frozenset[str], folder: Path) -> Episode | str:
    try:
        recording = read_recording(run / f"{trial_id}.h5")
        return rendering.episode(recording, success=trial_id in passed, folder=folder)[0]
    except RecordingError as error:
        return str(error)
