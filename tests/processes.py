"""What a failed test says of a process that should be gone."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


def described(pid: int) -> str:
    """Return id, state, parent, threads and command line."""
    folder, said = Path(f"/proc/{pid}"), [str(pid)]
    with suppress(OSError):
        for task in folder.glob("task/*/stat"):
            name, state = task.read_text().rpartition(")")[0].partition("(")[2], task.read_text().rpartition(")")[2]
            said.append(f"{name}: {' '.join(state.split()[:2])}")
        said.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")[:200])
        said.append((folder / "wchan").read_text())
    return "; ".join(said)
