"""Finds every process that a policy started, also those that left its process group and session. Linux only."""

from __future__ import annotations

import os
import secrets
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MARK = "CARECONTACT_POLICY_MARK"
"""Variable in a policy's environment, which every process that it starts inherits."""
PATIENCE_S = 2.0
"""Time [s] for ending processes that start others while they are being killed."""

_PROC = Path("/proc")


def new_mark() -> str:
    """Return a mark for one policy of this process."""
    return f"{marks_of(os.getpid())}{secrets.token_hex(8)}"


def marks_of(harness_pid: int) -> str:
    """Return the beginning of the marks of all policies that one harness process started."""
    return f"{harness_pid}."


def kill_marked(beginning: str) -> None:
    """Kill, by SIGKILL, the processes whose mark begins so and their descendants, until there are none.

    A process that removed the variable can be found only as long as the process that started it is alive.
    """
    _kill(lambda mark, process: mark.startswith(beginning))


def kill_abandoned() -> None:
    """Kill, by SIGKILL, the processes of policies whose harness is gone, and their descendants."""
    here = (_PROC / "self").resolve()
    if not here.is_dir():
        return

    def abandoned(mark: str, process: Path) -> bool:
        # Process ids inside a container on this machine have no meaning outside it.
        ours = (process / "ns" / "pid").readlink() == (here / "ns" / "pid").readlink()
        return ours and not (_PROC / mark.partition(".")[0]).is_dir()

    _kill(abandoned)


def _kill(wanted: Callable[[str, Path], bool]) -> None:
    until = time.monotonic() + PATIENCE_S
    while found := _marked(wanted):
        for pid in found:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        if time.monotonic() > until:
            return
        time.sleep(0.01)


def _marked(wanted: Callable[[str, Path], bool]) -> set[int]:
    """Return the ids of the living processes for which ``wanted`` is true, and of all their descendants.

    ``wanted`` receives a process's mark and its folder in /proc.
    """
    parent_of: dict[int, int] = {}
    found = set[int]()
    for folder in _PROC.glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            state, parent = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()[:2]
            if state in "ZX":
                continue
            pid = int(folder.name)
            parent_of[pid] = int(parent)
            marks = [v for v in (folder / "environ").read_bytes().split(b"\0") if v.startswith(f"{MARK}=".encode())]
            if any(wanted(mark.decode(errors="replace").partition("=")[2], folder) for mark in marks):
                found.add(pid)
    while more := {pid for pid, parent in parent_of.items() if parent in found and pid not in found}:
        found |= more
    return found - {os.getpid()}
