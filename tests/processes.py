"""Processes that a test starts indirectly: what lives, and what a failed test says of one that should be gone."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

NAMESPACE = "os.readlink('/proc/self/ns/pid')"
"""Code with which a policy learns what to write down beside its ids, which may be those of a namespace."""


def alive(pid: int | None) -> bool:
    """Whether any thread of a process runs: one that no process has reaped yet is dead."""
    with suppress(OSError):
        states = [path.read_text().rpartition(")")[2].split()[0] for path in Path(f"/proc/{pid}/task").glob("*/stat")]
        return any(state not in "ZX" for state in states)
    return False


def pid_here(pid: int, namespace: str) -> int | None:
    """Return the id here of a process that has the id ``pid`` in a pid namespace; None if there is none."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            status = (folder / "status").read_text(errors="replace")
            inside = status.partition("NSpid:")[2].partition("\n")[0].split()
            if inside[-1:] == [str(pid)] and os.readlink(folder / "ns" / "pid") == namespace:
                return int(folder.name)
    return None


def described(pid: int | None) -> str:
    """Return id, state, parent, threads and command line."""
    folder, state_lines = Path(f"/proc/{pid}"), [str(pid)]
    with suppress(OSError):
        for task in folder.glob("task/*/stat"):
            name, state = task.read_text().rpartition(")")[0].partition("(")[2], task.read_text().rpartition(")")[2]
            state_lines.append(f"{name}: {' '.join(state.split()[:2])}")
        state_lines.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")[:200])
        state_lines.append((folder / "wchan").read_text())
    return "; ".join(state_lines)
