"""Opens Rerun's viewer on a file, reachable from this machine only, and without its collection of usage data."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from carecontact.errors import DependencyError

LOOPBACK = "127.0.0.1"
SETTINGS = "XDG_CONFIG_HOME"
"""Variable that names the folder below which Rerun keeps its settings, on Linux."""


def command(path: Path) -> list[str]:
    """Return how the viewer is started: its server listens on the loopback address, at a free port.

    Raises DependencyError where the viewer is not installed.
    """
    return [_program(), "--bind", LOOPBACK, "--port", "auto", str(path)]


@contextmanager
def without_usage_data() -> Iterator[Mapping[str, str]]:
    """Yields the environment for a viewer that collects no usage data.

    Rerun has no variable for that: `rerun analytics disable` is its documented way, and writes a file of settings. It
    is called for a folder of settings that lasts as long as the block, so that the user's own stay as they are. Rerun
    reads the folder's variable on Linux alone; elsewhere the settings are the user's (docs/video.md).

    Raises DependencyError where the viewer is not installed, or does not do so.
    """
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
