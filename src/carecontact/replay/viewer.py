"""MuJoCo's own viewer on the states of a recorded trial, and whether a window can be opened."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import DependencyError
from carecontact.replay.replay import STATE, Replay

SPACE, LEFT, RIGHT, HOME = 32, 263, 262, 268
"""Keys as GLFW numbers them."""
SKIP_S = 1.0


def need_display() -> None:
    """Raises DependencyError where no window can be opened."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise DependencyError(
            "no display: neither DISPLAY nor WAYLAND_DISPLAY is set, so that no window can open; write a file with "
            "--save FILE.rrd and open it on a machine with a display, or make a video with carecontact view --video"
        )


@dataclass
class Player:
    """Which of ``count`` states is shown; the space bar pauses, the arrow keys skip a second, Home goes back."""

    count: int
    fps: float
    at: float = 0.0
    paused: bool = False

    def key(self, code: int) -> None:
        if code == SPACE:
            self.paused = not self.paused
        elif code in (LEFT, RIGHT, HOME):
            skip = {LEFT: -SKIP_S, RIGHT: SKIP_S, HOME: -self.at / self.fps}[code]
            self.at = min(max(self.at + skip * self.fps, 0.0), self.count - 1.0)

    def advance(self, seconds: float) -> int:
        """Return the index of the state to show after this much time; the last state stays."""
        if not self.paused:
            self.at = min(self.at + seconds * self.fps, self.count - 1.0)
        return int(self.at)


def positions(replay: Replay, fps: float) -> npt.NDArray[np.float64]:
    """(n, nq) of all shown states."""
    data, rows = mujoco.MjData(replay.model), []
    for stretch in replay.stretches(fps):
        for state in stretch.states:
            mujoco.mj_setState(replay.model, data, state, STATE)
            rows.append(data.qpos.copy())
    return np.array(rows)


def show(replay: Replay, *, fps: float) -> None:
    """Play the trial in a window, without dents of the skin. Raises DependencyError where no window can open."""
    need_display()
    viewer: Any = import_module("mujoco.viewer")
    rows, data = positions(replay, fps), mujoco.MjData(replay.model)
    player = Player(count=len(rows), fps=fps)
    with viewer.launch_passive(replay.model, data, key_callback=player.key) as window:
        before = time.monotonic()
        while window.is_running():
            now = time.monotonic()
            with window.lock():
                data.qpos[:] = rows[player.advance(now - before)]
                mujoco.mj_kinematics(replay.model, data)
                mujoco.mj_camlight(replay.model, data)
            window.sync()
            before = now
            time.sleep(max(0.0, 1 / fps - (time.monotonic() - now)))


LOOPBACK = "127.0.0.1"
SETTINGS = "XDG_CONFIG_HOME"
"""Variable that names the folder below which Rerun keeps its settings, on Linux."""


def command(path: Path) -> list[str]:
    """Return how to start the viewer: its server listens on the loopback address, at a free port."""
    return [_program(), "--bind", LOOPBACK, "--port", "auto", str(path)]


@contextmanager
def without_usage_data() -> Iterator[Mapping[str, str]]:
    """Yields the environment for a viewer that collects no usage data. `rerun analytics disable`, the documented way,
    writes settings, so it is called for a folder of settings that lasts as long as the block. Rerun reads that variable
    on Linux alone."""
    with tempfile.TemporaryDirectory(prefix="carecontact-rerun-") as folder:
        environment = os.environ | {SETTINGS: folder}
        if sys.platform == "linux":
            off = [_program(), "analytics", "disable"]
            done = subprocess.run(off, env=environment, check=False, capture_output=True, text=True)
            if done.returncode:
                raise DependencyError(f"Rerun's viewer does not switch its usage data off: {done.stderr[-200:]}")
        yield environment


def _program() -> str:
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.is_file() else shutil.which("rerun")
    if found is None:
        raise DependencyError("Rerun's viewer is not installed: pip install 'carecontact[viz]'")
    return found


def open_viewer(path: Path) -> int:
    """Show the file until its window is closed; returns the viewer's exit status."""
    with without_usage_data() as environment:
        return subprocess.run(command(path), env=environment, check=False).returncode
