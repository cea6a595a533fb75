"""``carecontact view --video``: recorded trials as videos."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

from carecontact.cli.groups import Switch, make_folder_of, need_recordings
from carecontact.errors import CarecontactError, ConfigError, RecordingError

if TYPE_CHECKING:
    from carecontact.replay.panel import Picture
    from carecontact.scoring.result import TrialScore

T = TypeVar("T")
TERMINAL_S, PLAIN_S = 0.25, 30.0
"""Time between two lines of progress, on a terminal and elsewhere."""
FOLDER = "trial"
"""Folder inside a run's folder in which the pages of its trials look for their videos."""
GIF_WIDTH = 640
"""Width of an animation [px]."""
VIDEO_FPS, DRAFT_FPS = 12.5, 6.25
MOST_FAILURES = 3
"""Number of failures of a run that are filmed without being asked for, at most one for each cause."""
MOST_JOBS = 8
"""Number of processes that draw where --jobs is not given, at most: each holds a renderer in memory."""
FRAMES_EACH = 25
"""Least number of frames for which another process pays, because it takes 2 s to start."""


@dataclass(frozen=True, kw_only=True)
class VideoGroup:
    """Options of ``carecontact view --video``, and the videos that they ask for."""

    heading: ClassVar = "video"

    camera: str = "contact"
    """With --video: contact (near the region), orbit (turns round it), or one of the protocol's cameras, such as
    overhead, bedside, exterior or wrist."""
    draft: Switch = False
    """With --video: draw no shadows and fewer frames, for a first look: more than twice as fast."""
    jobs: int | None = None
    """With --video: number of processes that draw; default: one per core, at most 8, and fewer for a short video. The
    video does not depend on it."""
    no_grid: Switch = False
    """With --video: draw no lines on the region's skin."""
    again: Switch = False
    """With --video: make videos again that exist already."""

    def write(self, place: Path, *, out: Path | None, fps: float | None) -> int:
        """Make a video of one recorded trial or of every trial of a run. Return 1 if a trial of the run cannot be
        shown.

        Raises ConfigError for wrong options, RecordingError where the one trial cannot be shown, and DependencyError
        where the extra is not installed or nothing can be rendered.
        """
        from carecontact.replay.film import pyav
        from carecontact.running.supervisor import check_jobs

        check_jobs(self.jobs)
        trials = self._trials(place, out)
        pyav()
        fps = fps or (DRAFT_FPS if self.draft else VIDEO_FPS)
        left_out = 0
        for number, trial in enumerate(trials, 1):
            name = trial.stem if self.camera == "contact" else f"{trial.stem}-{self.camera}"
            target = out or trial.parent / FOLDER / f"{name}.mp4"
            try:
                self._make(trial, target, fps=fps, prefix=f"[{number}/{len(trials)}] " if len(trials) > 1 else "")
            except RecordingError as error:
                if not place.is_dir():
                    raise
                left_out += 1
                print(f"left out: {error}", flush=True)
        return 1 if left_out else 0

    def _trials(self, place: Path, out: Path | None) -> list[Path]:
        if not place.is_dir() and place.suffix == ".h5":
            if out is not None and out.suffix not in (".mp4", ".gif"):
                raise ConfigError(f"--out {out}: name a file that ends in .mp4 or .gif")
            return [place]
        if out is not None:
            raise ConfigError("--out names the file for one trial's video; the videos of a run go to its folder trial")
        need_recordings(place)
        return sorted(place.glob("*.h5"))

    def _make(self, trial: Path, target: Path, *, fps: float, prefix: str) -> None:
        from carecontact.recording import read_recording
        from carecontact.replay.film import Film, comment_of, write_gif, write_mp4
        from carecontact.running.workers import available_cores

        recording = read_recording(trial)
        comment = self._comment(recording.stored_sha256, fps)
        if not self.again and target.suffix == ".mp4" and comment_of(target) == comment:
            print(f"{prefix}{target}: is there already", flush=True)
            return
        film = Film(recording, view=self.camera, fps=fps, grid=not self.no_grid, shadows=not self.draft)
        make_folder_of(target)
        jobs = self.jobs or max(1, min(available_cores(), MOST_JOBS, film.count // FRAMES_EACH))
        with closing(film.frames(jobs=jobs)) as pictures:
            frames = counted(pictures, film.count, f"{prefix}{trial.stem}")
            if target.suffix == ".gif":
                write_gif(target, _smaller(frames), fps=fps)
            else:
                write_mp4(target, frames, fps=fps, comment=comment)
        size = target.stat().st_size / 1e6
        print(f"{prefix}{target}: {film.count} frames, {size:.1f} MB; {film.found}", flush=True)

    def _comment(self, sha256: str, fps: float) -> str:
        """Return what a video was made of: a video with another comment is made again."""
        from carecontact import __version__

        facts = {"recording": sha256, "carecontact": __version__, "view": self.camera, "fps": fps}
        return json.dumps({**facts, "grid": not self.no_grid, "draft": self.draft}, sort_keys=True)


def film_failures(folder: Path, scores: Iterable[TrialScore]) -> None:
    """Make draft videos of a run's first failures, one for each cause, where the run's report links them.

    A video that cannot be made is named, and keeps no run from its scores.
    """
    first: dict[tuple[str | None, str | None], TrialScore] = {}
    for score in scores:
        if score.failure_mode is not None and not score.is_crash:
            first.setdefault((score.failure_mode, score.attribution), score)
    for score in list(first.values())[:MOST_FAILURES]:
        try:
            VideoGroup(draft=True).write(folder / f"{score.trial_id}.h5", out=None, fps=None)
        except CarecontactError as error:
            print(f"no video of {score.trial_id}: {error}", flush=True)


def counted(items: Iterable[T], total: int, name: str) -> Iterator[T]:
    """Yield the items, and print how many of ``total`` there have been and how much time is left: in one line that is
    rewritten on a terminal, and elsewhere in a new line every 30 s."""
    began = printed = time.monotonic()
    terminal = sys.stdout.isatty()
    for number, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if now - printed >= (TERMINAL_S if terminal else PLAIN_S):
            printed = now
            left_s = (now - began) / number * (total - number)
            line = f"{name}: frame {number} of {total}, {left_s:.0f} s left"
            print(f"\r{line:<70}" if terminal else line, end="" if terminal else "\n", flush=True)
    if terminal:
        print(f"\r{'':<70}\r", end="", flush=True)


def _smaller(frames: Iterable[Picture]) -> Iterator[Picture]:
    from carecontact.pictures import shrunk

    for frame in frames:
        yield shrunk(frame, GIF_WIDTH)
