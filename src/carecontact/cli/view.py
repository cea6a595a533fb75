"""``carecontact view``: recorded trials in a viewer, as videos, at their start, and with what a policy noted."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeVar

import tyro

from carecontact.cli.groups import (
    RulesGroup,
    SaltGroup,
    Switch,
    VisionGroup,
    chosen_trial,
    make_folder_of,
    need_recordings,
)
from carecontact.cli.parsing import UsageError, given_options, option_names
from carecontact.errors import CarecontactError, ConfigError, RecordingError

if TYPE_CHECKING:
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
FPS = (1.0, 60.0)
"""Lowest and highest rate that can be asked for [1/s]."""
VIEWER_FPS = 12.5


@dataclass(frozen=True, kw_only=True)
class ViewerGroup:
    """Options of ``carecontact view`` without a mode."""

    heading: ClassVar = "viewer"

    save: Path | None = None
    """Write a file for Rerun, .rrd, and open no window; needs no display."""
    mujoco: Switch = False
    """Open MuJoCo's own viewer instead of Rerun's. The space bar pauses, the arrow keys skip a second."""

    def show(self, trial: Path, *, fps: float) -> int:
        from carecontact.recording import read_recording
        from carecontact.replay.replay import Replay
        from carecontact.replay.rerun_file import rerun_sdk
        from carecontact.replay.viewer import need_display, open_viewer, show

        if self.save is not None and (self.mujoco or self.save.suffix != ".rrd"):
            raise ConfigError(f"--save {self.save}: name a file that ends in .rrd, without --mujoco")
        if self.mujoco:
            need_display()
            show(Replay(read_recording(trial)), fps=fps)
            return 0
        rerun_sdk()
        if self.save is not None:
            _write(trial, self.save, fps=fps)
            return 0
        need_display()
        with tempfile.TemporaryDirectory(prefix="carecontact-view-") as folder:
            path = Path(folder) / f"{trial.stem}.rrd"
            _write(trial, path, fps=fps)
            return 1 if open_viewer(path) else 0


def _write(trial: Path, path: Path, *, fps: float) -> None:
    from carecontact.recording import read_recording
    from carecontact.replay.rerun_file import save

    recording = read_recording(trial)
    make_folder_of(path)
    found = save(recording, path, fps=fps)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; {found}")


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
        """Make a video of one trial or of every trial of a run. Return 1 if a trial of the run cannot be shown."""
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
        from carecontact.pictures import shrunk
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
                write_gif(target, (shrunk(frame, GIF_WIDTH) for frame in frames), fps=fps)
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
    """Make draft videos of a run's first failures, one for each cause, where the run's report links them."""
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
    """Yield the items, and print how many of ``total`` there have been and how much time is left."""
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


@dataclass(frozen=True, kw_only=True)
class StartGroup:
    """Options of ``carecontact view --start``."""

    heading: ClassVar = "start"

    task: str | None = None
    """With --start: task of the protocol, such as T1; default: the protocol's first."""
    seed: int | None = None
    """With --start: seed of the protocol; default: its first."""
    rules: RulesGroup = field(default_factory=RulesGroup)
    tool: str | None = None
    """What the robot's hand wears in place of the protocol's: rigid `caps` over the fingertips, or a soft wash `mitt`.
    The sheet names this change."""
    vision: VisionGroup = field(default_factory=VisionGroup)
    salted: SaltGroup = field(default_factory=SaltGroup)

    def draw(self, out: Path | None) -> int:
        from carecontact.cli.policy import with_vision
        from carecontact.interface.observation import MODALITIES
        from carecontact.interface.policy import CAMERAS, PolicyCard
        from carecontact.protocol.load import load_protocol
        from carecontact.report.look_sheet import check_sheet_path, save_sheet
        from carecontact.running.machine import check_ready
        from carecontact.runs.plan import check_protocol

        loaded = load_protocol(self.rules.protocol, level=self.rules.level)
        rules = self.rules.changed(loaded, tool={} if self.tool is None else {"scene.tool": self.tool})
        rules = with_vision(rules, self.vision)
        task, seed = chosen_trial(rules, task=self.task, seed=self.seed)
        path = check_sheet_path(out or Path(f"start-{task}-s{seed:03d}.png"))
        check_protocol(rules)
        check_ready()
        from carecontact.episode.episode import first_look  # Not before, since MuJoCo comes with it.

        card = PolicyCard(name="look", modalities=MODALITIES, cameras=CAMERAS)
        observation = first_look(
            rules, task_id=task, seed=seed, card=card, weights=self.vision.weights, salt=self.salted.salt
        )
        name = rules.task(task).name
        title = f"{task} {name}, seed {seed}, {rules.title} (the policy does not receive this line)"
        save_sheet(observation, path, title=title)
        print(f"{path}: {task} seed {seed}, {len(CAMERAS)} cameras")
        return 0


@dataclass(frozen=True, kw_only=True)
class View:
    """Look at a recorded trial from every side in Rerun: the skin that gives way, the robot, what the policy saw,
    forces and the person's joints on one time axis. --video makes videos in its place, --start shows what a policy
    sees when a trial begins, and --notes what a policy noted."""

    place: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL.h5|RUN")] = None
    """Recording of one trial; with --video also the --out folder of a run; with --start nothing."""
    viewer: ViewerGroup = field(default_factory=ViewerGroup)
    video: Switch = False
    """Make a video of the trial, or of every trial of the run: the world from a camera, with the force over time, the
    pressure on the region, and the events. The trial is stepped again from its recording, and compared with it. Videos
    that exist already are kept."""
    start: Switch = False
    """Draw on one sheet everything that a policy can receive when a trial begins: every camera and every modality."""
    notes: Switch = False
    """Draw what the policy noted in the trial, on top of the image that it saw: the options and the choice of
    state-machine, or the value maps and paths of voxposer. If voxposer planned nothing, draw its program and what
    stopped it."""
    out: Path | None = None
    """File to write. With --video: .mp4 or .gif, for one trial; default: trial/NAME.mp4 beside the recording. With
    --start and --notes: .png, .jpg or .pdf; default: start-TASK-sSEED.png or notes-TRIAL.png in the current folder."""
    fps: float | None = None
    """Pictures in a second of the trial, 1 to 60; default: 12.5 in the viewer and with --video, 6.25 with --draft."""
    films: VideoGroup = field(default_factory=VideoGroup)
    sheet: StartGroup = field(default_factory=StartGroup)

    @property
    def after_interrupt(self) -> str:
        return (
            "; finished videos are kept, the same command makes the others" if self.video else "; nothing was written"
        )

    def __call__(self) -> int:
        self._check()
        if self.start:
            return self.sheet.draw(self.out)
        if self.place is None:
            raise UsageError("view: name the recording of a trial (TRIAL.h5), or give --start")
        if self.video:
            return self.films.write(self.place, out=self.out, fps=self.fps)
        if self.place.is_dir():
            raise ConfigError(f"{self.place}: this is a folder; name one recording in it (TRIAL.h5), or give --video")
        return self._draw_notes(self.place) if self.notes else self.viewer.show(self.place, fps=self.fps or VIEWER_FPS)

    def _check(self) -> None:
        modes = {
            "view": ["place", "--fps", *option_names(ViewerGroup)],
            "view --video": ["place", "--out", "--fps", *option_names(VideoGroup)],
            "view --start": ["--out", *option_names(StartGroup)],
            "view --notes": ["place", "--out"],
        }
        given = given_options(self)
        chosen = [option for option in ("--video", "--start", "--notes") if option in given]
        if len(chosen) > 1:
            raise ConfigError(f"{' and '.join(chosen)} exclude each other; give one of them")
        mode = " ".join(["view", *chosen])
        for option in given:
            if option not in (*chosen, *modes[mode]):
                owners = " or ".join(f"`carecontact {name}`" for name, options in modes.items() if option in options)
                raise ConfigError(f"{mode}: {'TRIAL.h5' if option == 'place' else option} belongs to {owners}")
        if self.fps is not None and not FPS[0] <= self.fps <= FPS[1]:
            raise ConfigError(f"--fps {self.fps:g}: valid are {FPS[0]:g} to {FPS[1]:g}")

    def _draw_notes(self, trial: Path) -> int:
        from carecontact.recording import read_recording
        from carecontact.report.look_sheet import check_sheet_path
        from carecontact.report.notes_picture import save_notes_picture

        path = check_sheet_path(self.out or Path(f"notes-{trial.stem}.png"))
        save_notes_picture(read_recording(trial), path)
        print(f"{path}: {trial.stem}")
        return 0
