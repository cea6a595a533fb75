"""``carecontact video``, ``view`` and ``notes``: recorded trials as films, in a viewer, and as pictures of what a
policy noted."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeVar

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from carecontact.replay.film import Film
    from carecontact.replay.panel import Picture


# Progress of a video: one line that is rewritten on a terminal, and elsewhere a new line every 30 s.

T = TypeVar("T")
TERMINAL_S, PLAIN_S = 0.25, 30.0
"""Time between two lines, on a terminal and elsewhere."""


def counted(items: Iterable[T], total: int, name: str) -> Iterator[T]:
    """Yield the items, and print how many of ``total`` there have been and how much time is left."""
    began = told = time.monotonic()
    terminal = sys.stdout.isatty()
    for number, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if now - told >= (TERMINAL_S if terminal else PLAIN_S):
            told = now
            left_s = (now - began) / number * (total - number)
            line = f"{name}: frame {number} of {total}, {left_s:.0f} s left"
            print(f"\r{line:<70}" if terminal else line, end="" if terminal else "\n", flush=True)
    if terminal:
        print(f"\r{'':<70}\r", end="", flush=True)


# ``carecontact video``: recorded trials as videos.

FOLDER = "trial"
"""Folder inside a run's folder in which the pages of its trials look for their videos."""
GIF_WIDTH = 640
"""Width of an animation [px]."""
FPS = (1.0, 60.0)
"""Lowest and highest rate that can be asked for [1/s]."""
FILM_FPS, DRAFT_FPS = 25.0, 10.0
MOST_JOBS = 8
"""Number of processes that draw where --jobs is not given, at most: each holds a renderer in memory."""
FRAMES_EACH = 25
"""Least number of frames for which another process pays, because it takes 2 s to start."""


@dataclass(frozen=True, kw_only=True)
class Video:
    """Make a video of one recorded trial, or of every trial of a run: the world from a camera of your choice, with the
    force over time, the pressure on the region, and the events. The trial is stepped again from its recording, and
    compared with it. Videos that exist already are kept."""

    what: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL.h5|RUN")]
    """Recording of one trial, or the --out folder of a run."""
    view: str = "contact"
    """Camera: contact (near the region), orbit (turns round it), or one of the protocol's, such as overhead, bedside,
    exterior or wrist."""
    out: Path | None = None
    """File for the video of one trial, .mp4 or .gif; default: trial/NAME.mp4 beside the recording."""
    fps: float | None = None
    """Frames in a second of the trial, 1 to 60; default: 25, with --draft 10."""
    draft: Switch = False
    """Draw no shadows and fewer frames, for a first look: about three times faster."""
    jobs: int | None = None
    """Number of processes that draw; default: one per core, at most 8, and fewer for a short video. The video does not
    depend on it."""
    no_grid: Switch = False
    """Draw no lines on the region's skin."""
    again: Switch = False
    """Make videos again that exist already."""

    after_interrupt: ClassVar[str] = "; finished videos are kept, the same command makes the others"

    def __call__(self) -> int:
        """Return 1 if a trial of the run cannot be shown.

        Raises ConfigError for wrong options, RecordingError where the one trial cannot be shown, and DependencyError
        where the extra is not installed or nothing can be rendered.
        """
        from carecontact.replay.film import pyav
        from carecontact.running.supervisor import check_jobs

        if not FPS[0] <= self._fps <= FPS[1]:
            raise ConfigError(f"--fps {self._fps:g}: valid are {FPS[0]:g} to {FPS[1]:g}")
        check_jobs(self.jobs)
        trials = self._trials()
        pyav()
        left_out = 0
        for number, trial in enumerate(trials, 1):
            try:
                self._make(trial, self._target(trial), place=f"[{number}/{len(trials)}] " if len(trials) > 1 else "")
            except RecordingError as error:
                if not self.what.is_dir():
                    raise
                left_out += 1
                print(f"left out: {error}", flush=True)
        return 1 if left_out else 0

    @property
    def _fps(self) -> float:
        return self.fps if self.fps is not None else DRAFT_FPS if self.draft else FILM_FPS

    def _trials(self) -> list[Path]:
        from carecontact.cli.score import need_recordings

        if not self.what.is_dir() and self.what.suffix == ".h5":
            if self.out is not None and self.out.suffix not in (".mp4", ".gif"):
                raise ConfigError(f"--out {self.out}: name a file that ends in .mp4 or .gif")
            return [self.what]
        if self.out is not None:
            raise ConfigError("--out names the file for one trial's video; the videos of a run go to its folder trial")
        need_recordings(self.what)
        return sorted(self.what.glob("*.h5"))

    def _target(self, trial: Path) -> Path:
        name = trial.stem if self.view == "contact" else f"{trial.stem}-{self.view}"
        return self.out or trial.parent / FOLDER / f"{name}.mp4"

    def _make(self, trial: Path, target: Path, *, place: str) -> None:
        from carecontact.cli.groups import make_place
        from carecontact.recording import read_recording
        from carecontact.replay.film import Film, comment_of, write_gif, write_mp4
        from carecontact.running.workers import available_cores

        recording = read_recording(trial)
        comment = self._comment(recording.stored_sha256)
        if not self.again and target.suffix == ".mp4" and comment_of(target) == comment:
            print(f"{place}{target}: is there already", flush=True)
            return
        film = Film(recording, view=self.view, fps=self._fps, grid=not self.no_grid, shadows=not self.draft)
        make_place(target)
        jobs = self.jobs or max(1, min(available_cores(), MOST_JOBS, film.count // FRAMES_EACH))
        with closing(film.frames(jobs=jobs)) as pictures:
            frames = counted(pictures, film.count, f"{place}{trial.stem}")
            if target.suffix == ".gif":
                write_gif(target, _smaller(frames), fps=self._fps)
            else:
                write_mp4(target, frames, fps=self._fps, comment=comment)
        self._say(film, target, place)

    def _say(self, film: Film, target: Path, place: str) -> None:
        size = target.stat().st_size / 1e6
        print(f"{place}{target}: {film.count} frames, {size:.1f} MB; {film.found}", flush=True)

    def _comment(self, sha256: str) -> str:
        """Return what a video was made of: a video with another comment is made again."""
        from carecontact import __version__

        facts = {
            "recording": sha256, "carecontact": __version__, "view": self.view, "fps": self._fps,
            "grid": not self.no_grid, "draft": self.draft,
        }  # fmt: skip
        return json.dumps(facts, sort_keys=True)


def _smaller(frames: Iterable[Picture]) -> Iterator[Picture]:
    import cv2
    import numpy as np

    from carecontact.replay.film import SIZE

    to = (GIF_WIDTH, round(GIF_WIDTH * SIZE[1] / SIZE[0]))
    for frame in frames:
        yield np.asarray(cv2.resize(frame, to, interpolation=cv2.INTER_AREA), np.uint8)


# ``carecontact view``: a recorded trial in a viewer.


@dataclass(frozen=True, kw_only=True)
class View:
    """Look at a recorded trial from every side: in Rerun, with the skin that gives way, the robot, what the policy
    saw, forces and the person's joints on one time axis; or in MuJoCo's own viewer."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL.h5")]
    """Recording of one trial."""
    save: Path | None = None
    """Write a file for Rerun, .rrd, and open no window; needs no display."""
    mujoco: Switch = False
    """Open MuJoCo's own viewer instead of Rerun's. The space bar pauses, the arrow keys skip a second."""
    fps: float = 12.5
    """States in a second of the trial, 1 to 60."""

    after_interrupt: ClassVar[str] = "; no file was written"

    def __call__(self) -> int:
        """Raises ConfigError for wrong options, RecordingError for a recording that cannot be shown, and
        DependencyError where there is no display or the extra is not installed."""
        if not FPS[0] <= self.fps <= FPS[1]:
            raise ConfigError(f"--fps {self.fps:g}: valid are {FPS[0]:g} to {FPS[1]:g}")
        if self.save is not None and (self.mujoco or self.save.suffix != ".rrd"):
            raise ConfigError(f"--save {self.save}: name a file that ends in .rrd, without --mujoco")
        if self.mujoco:
            return self._in_mujoco()
        if self.save is not None:
            return self._write(self.save)
        return self._in_rerun()

    def _in_mujoco(self) -> int:
        from carecontact.recording import read_recording
        from carecontact.replay.replay import Replay
        from carecontact.replay.viewer import need_display, show

        need_display()
        show(Replay(read_recording(self.recording)), fps=self.fps)
        return 0

    def _in_rerun(self) -> int:
        from carecontact.replay.rerun_file import rerun_sdk
        from carecontact.replay.viewer import need_display, open_viewer

        rerun_sdk()
        need_display()
        with tempfile.TemporaryDirectory(prefix="carecontact-view-") as folder:
            path = Path(folder) / f"{self.recording.stem}.rrd"
            self._write(path)
            return 1 if open_viewer(path) else 0

    def _write(self, path: Path) -> int:
        from carecontact.cli.groups import make_place
        from carecontact.recording import read_recording
        from carecontact.replay.rerun_file import rerun_sdk, save

        rerun_sdk()
        recording = read_recording(self.recording)
        make_place(path)
        found = save(recording, path, fps=self.fps)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; {found}")
        return 0


# ``carecontact notes``: a picture of what a policy noted in one trial.


@dataclass(frozen=True, kw_only=True)
class Notes:
    """Draw what a policy noted in a trial, on top of the image that it saw: the options and the choice of
    state-machine, or the value maps and paths of voxposer. If voxposer planned nothing, draw its program and what
    stopped it."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL.h5")]
    """Recording of one trial of state-machine, voxposer or voxposer-phased."""
    out: Path | None = None
    """Picture to write, .png, .jpg or .pdf; default: notes-TRIAL.png in the current folder."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Raises ConfigError where there is nothing to draw, RecordingError for a file that is not a recording."""
        from carecontact.recording import read_recording
        from carecontact.report.look_sheet import check_sheet_path
        from carecontact.report.notes_picture import save_notes_picture

        path = check_sheet_path(self.out or Path(f"notes-{self.recording.stem}.png"))
        save_notes_picture(read_recording(self.recording), path)
        print(f"{path}: {self.recording.stem}")
        return 0
