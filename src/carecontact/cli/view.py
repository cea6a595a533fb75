"""``carecontact view``: a recorded trial in a viewer."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import ConfigError

FPS = (1.0, 60.0)


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
        from carecontact.replaying.replay import Replay
        from carecontact.replaying.viewer.passive import need_display, show

        need_display()
        show(Replay(read_recording(self.recording)), fps=self.fps)
        return 0

    def _in_rerun(self) -> int:
        from carecontact.replaying.viewer.passive import need_display
        from carecontact.replaying.viewer.rerun_file import rerun_sdk
        from carecontact.replaying.viewer.window import open_viewer

        rerun_sdk()
        need_display()
        with tempfile.TemporaryDirectory(prefix="carecontact-view-") as folder:
            path = Path(folder) / f"{self.recording.stem}.rrd"
            self._write(path)
            return 1 if open_viewer(path) else 0

    def _write(self, path: Path) -> int:
        from carecontact.cli.target import make_place
        from carecontact.recording import read_recording
        from carecontact.replaying.viewer.rerun_file import rerun_sdk, save

        rerun_sdk()
        recording = read_recording(self.recording)
        make_place(path)
        found = save(recording, path, fps=self.fps)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB; {found}")
        return 0
