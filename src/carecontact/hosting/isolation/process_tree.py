"""What stands in for a pid namespace where the system grants none: a process adopts what its descendants leave, and
kills it. Linux tells whose children they are; elsewhere, only the policy's process group is killed."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

from carecontact.own_process import adopt_orphans

PATIENCE_S = 2.0
"""Time [s] for ending processes that start others while they are being killed."""
_TASKS = Path("/proc/self/task")

_all_children = False


def claim_children() -> None:
    """Declare that every child that this process has, or adopts from now on, belongs to a policy; adopt orphans."""
    global _all_children
    _all_children = True
    adopt_orphans()


def kill_claimed() -> None:
    """Kill all children of this process, if it called ``claim_children``."""
    if _all_children:
        kill_children({})


def kill_children(statuses: dict[int, int | None]) -> None:
    """Send SIGKILL to all children of this process, and to those that it adopts meanwhile, until none is left or
    PATIENCE_S is over. Every descendant becomes a child when its own parent ends, if this process adopts orphans.

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
    with suppress(OSError):  # A thread that has just ended, or another system.
        for task in _TASKS.iterdir():
            found.update(map(int, (task / "children").read_text().split()))
    return found
