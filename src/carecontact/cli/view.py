"""``carecontact view``: recorded trials in a viewer, as videos, at their start, and with what a policy noted."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from carecontact.cli.groups import RulesGroup, SaltGroup, Switch, VisionGroup, check_trial, make_folder_of
from carecontact.cli.parsing import UsageError, given_options, option_names
from carecontact.cli.video import VideoGroup
from carecontact.errors import ConfigError

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
        """Raises RecordingError for a recording that cannot be shown, and DependencyError where there is no display or
        the extra is not installed."""
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
        """Raises ConfigError for a task or seed that the protocol does not have."""
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
        task = self.task or rules.tasks[0].id
        seed = rules.randomization.seeds[0] if self.seed is None else self.seed
        check_trial(rules, task=task, seed=seed)
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
        """Return 1 if the viewer fails or a trial of a run cannot be shown. Raises ConfigError for wrong options."""
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
        """Raises ConfigError for an option of another mode than the one that is given."""
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
        """Raises ConfigError where there is nothing to draw, RecordingError for a file that is not a recording."""
        from carecontact.recording import read_recording
        from carecontact.report.look_sheet import check_sheet_path
        from carecontact.report.notes_picture import save_notes_picture

        path = check_sheet_path(self.out or Path(f"notes-{trial.stem}.png"))
        save_notes_picture(read_recording(trial), path)
        print(f"{path}: {trial.stem}")
        return 0
