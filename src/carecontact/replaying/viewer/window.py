"""Opens Rerun's viewer on a file, reachable from this machine only."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from carecontact.errors import DependencyError

LOOPBACK = "127.0.0.1"


def command(path: Path) -> list[str]:
    """How the viewer is started: its server listens on the loopback address, at a free port.

    Raises DependencyError where the viewer is not installed.
    """
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.is_file() else shutil.which("rerun")
    if found is None:
        raise DependencyError("Rerun's viewer is not installed: pip install 'carecontact[viz]'")
    return [found, "--bind", LOOPBACK, "--port", "auto", str(path)]


def open_viewer(path: Path) -> int:
    """Show the file until its window is closed; returns the viewer's exit status."""
    return subprocess.run(command(path), check=False).returncode
