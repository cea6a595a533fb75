"""Finds every process that a policy started, also those that left its process group and session. Linux only."""

from __future__ import annotations

import os
import secrets
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from carecontact.hosting.isolation.private_folder import REMOVER
from carecontact.own_process import adopt_orphans

MARK = "CARECONTACT_POLICY_MARK"
"""Variable in a policy's environment, which every process that it starts inherits."""
PATIENCE_S = 2.0
"""Time [s] for ending processes that start others while they are being killed."""

_PROC = Path("/proc")
_TASKS = "/proc/self/task"

_all_children = False


def new_mark() -> str:
    """Return a mark for one policy of this process."""
    return f"{marks_of(os.getpid())}{secrets.token_hex(8)}"


def marks_of(harness_pid: int) -> str:
    """Return the beginning of the marks of all policies that one harness process started."""
    return f"{harness_pid}."


def kill_marked(beginning: str, *, grace_s: float = 0.0) -> None:
    """Kill, by SIGKILL, the processes whose mark begins so and their descendants, until there are none.

    A process that removed the variable, or hides it, is found as long as the process that started it is alive.

    Args:
        grace_s: time [s] for them to end by themselves.
    """

    def marked(folder: Path, parent: int) -> bool:
        return any(mark.startswith(beginning) for mark in _marks(folder))

    until = time.monotonic() + grace_s
    while time.monotonic() < until and _found(marked):
        time.sleep(0.01)
    _kill(marked)


def kill_abandoned() -> None:
    """Kill, by SIGKILL, the processes of policies whose harness is gone, and their descendants."""
    here = (_PROC / "self").resolve()
    if not here.is_dir():
        return

    def abandoned(folder: Path, parent: int) -> bool:
        # Process ids inside a container on this machine have no meaning outside it.
        return any(
            (folder / "ns" / "pid").readlink() == (here / "ns" / "pid").readlink()
            and not (_PROC / mark.partition(".")[0]).is_dir()
            for mark in _marks(folder)
        )

    _kill(abandoned)


def claim_children() -> None:
    """Declare that every child that this process has, or adopts from now on, belongs to a policy; adopt orphans."""
    global _all_children
    _all_children = True
    adopt_orphans()


def kill_adopted() -> None:
    """Kill the processes of policies that this process adopted when their keeper died, for PATIENCE_S at most.

    After ``claim_children``, these are all children of this process. Otherwise, they are the children with more filters
    of system calls than this process has: isolation gives a policy's process such a filter, and nothing removes it.
    """
    if _all_children:
        kill_children({})
        return
    if sys.platform != "linux":
        return
    own, until = _filters("self"), time.monotonic() + PATIENCE_S
    while time.monotonic() < until and (found := [pid for pid in _children() if _filters(str(pid)) > own]):
        for pid in found:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, os.WNOHANG)


def removals() -> int:
    """Return how many processes that this one adopted, or started, still remove the folder of a policy; reap those that
    have ended, since nobody else does."""
    going_on = 0
    for pid in _children():
        with suppress(OSError):
            name = (_PROC / str(pid) / "comm").read_text(errors="replace").strip()
            going_on += name == REMOVER and os.waitpid(pid, os.WNOHANG)[0] == 0
    return going_on


def wait_for_children(most_s: float) -> bool:
    """Wait until this process has no child that lives, such as one that removes files; return whether that is so.

    Call it only in a process that called ``claim_children``."""
    until = time.monotonic() + most_s
    while True:
        with suppress(ChildProcessError):
            reap({})
        if not _children() or time.monotonic() > until:
            return not _children()
        time.sleep(0.05)


def _filters(process: str) -> int:
    """Return the number of filters of system calls (seccomp) that bind a process; 0 if the kernel does not tell it
    (before Linux 5.9)."""
    with suppress(OSError, ValueError):
        for line in (_PROC / process / "status").read_text(errors="replace").splitlines():
            if line.startswith("Seccomp_filters:"):
                return int(line.partition(":")[2])
    return 0


def kill_children(statuses: dict[int, int | None]) -> None:
    """Send SIGKILL to all children of this process, and to those that it adopts meanwhile, until none is left or
    PATIENCE_S is over.

    Call it only in a process that called ``adopt_orphans`` before it started any other. Every descendant then becomes
    a child of this process when its own parent ends.

    Args:
        statuses: see ``reap``.
    """
    until = time.monotonic() + PATIENCE_S
    last = set[int]()
    with suppress(ChildProcessError):
        while time.monotonic() < until:
            found = _children()
            for pid in found:
                with suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            # No pause while others appear: a process that forks and ends at once is a child for some 50 us.
            if not reap(statuses, most=len(found) + 1) and found == last:
                time.sleep(0.001)
            last = found


def reap(statuses: dict[int, int | None], *, most: int = 256) -> bool:
    """Reap up to ``most`` children that have ended, since they can end faster than that; return whether there may be
    more of them.

    Args:
        statuses: process id -> exit status, as ``subprocess.Popen.returncode``; filled in for the ids that it holds.

    Raises ChildProcessError if there is no child.
    """
    for _ in range(most):
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            return False
        if pid in statuses:
            statuses[pid] = os.waitstatus_to_exitcode(status)
    return True


def _children() -> set[int]:
    found = set[int]()
    try:
        for task in os.listdir(_TASKS):
            with open(f"{_TASKS}/{task}/children", "rb") as listed:
                found.update(map(int, listed.read().split()))
    except OSError:
        # A kernel without these lists (CONFIG_PROC_CHILDREN), or a thread that has just ended.
        own = os.getpid()
        return {pid for pid, (_, parent) in _table().items() if parent == own}
    return found


def _kill(wanted: Callable[[Path, int], bool]) -> None:
    """``wanted`` receives a process's folder in /proc and its parent's id."""
    until = time.monotonic() + PATIENCE_S
    while found := _found(wanted):
        for pid in found:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        if time.monotonic() > until:
            return
        time.sleep(0.01)


def _found(wanted: Callable[[Path, int], bool]) -> set[int]:
    """Return the ids of the living processes for which ``wanted`` is true, and of all their descendants."""
    living = {pid: parent for pid, (state, parent) in _table().items() if state not in "ZX"}
    found = set[int]()
    for pid, parent in living.items():
        with suppress(OSError, ValueError):
            if wanted(_PROC / str(pid), parent):
                found.add(pid)
    while more := {pid for pid, parent in living.items() if parent in found and pid not in found}:
        found |= more
    return found - {os.getpid()}


def _table() -> dict[int, tuple[str, int]]:
    """Process id -> state and parent, as far as the system shows them."""
    found: dict[int, tuple[str, int]] = {}
    for folder in _PROC.glob("[0-9]*"):
        with suppress(OSError, ValueError):
            state, parent = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()[:2]
            # Its first thread has ended; the others still run, and hold files and locks.
            if state == "Z" and len(os.listdir(folder / "task")) > 1:
                state = "R"
            found[int(folder.name)] = state, int(parent)
    return found


def _marks(folder: Path) -> list[str]:
    variables = (folder / "environ").read_bytes().split(b"\0")
    named = f"{MARK}=".encode()
    return [found.removeprefix(named).decode(errors="replace") for found in variables if found.startswith(named)]
