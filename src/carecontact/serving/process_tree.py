"""Looks after processes that were started: which descriptors can be read, where a process hangs, and what it has
started itself. Linux lists the children of a process; elsewhere, only the policy's process group is killed."""

from __future__ import annotations

import faulthandler
import importlib
import math
import os
import re
import select
import signal
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import carecontact

ASK = signal.SIGQUIT
"""The signal that asks a process for its Python stack, as in Java and Go."""
STACK_PATIENCE_S = 1.0
"""Longest wait [s] for the stack; a process that was stopped by a signal gives none."""
PAUSE_S = 0.1
"""If no further line comes for this time [s], the stack is complete."""
WHOLE_S = 1.0
"""Longest time [s] from the first line to the last: the policy can write there, too, and go on and on."""
MOST_BYTES = 65536
PLUMBING = tuple(f"{Path(carecontact.__file__).parent / folder}{os.sep}" for folder in ("serving", "interface"))
"""Folders whose code calls every policy or checks its values, and therefore explains no mistake of a policy."""
CHILDREN_PATIENCE_S = 2.0
"""Time [s] for ending processes that start others while they are being killed."""
_FRAME = re.compile(r'  File "(.+)", line (\d+) in (.+)')


def readable_descriptors(descriptors: Iterable[int], timeout_s: float | None = None) -> list[int]:
    """Return the descriptors that have something to read, or have reached their end; ``select.select`` would refuse
    numbers from 1024 on. ``timeout_s``: longest wait [s] for the first one; None waits until there is one."""
    watch = select.poll()
    for descriptor in descriptors:
        watch.register(descriptor, select.POLLIN)
    return [found for found, _ in watch.poll(None if timeout_s is None else math.ceil(max(timeout_s, 0.0) * 1e3))]


def is_plumbing(file: str) -> bool:
    """Whether frames of this file belong to the harness, which calls the policy or imports its module."""
    return file.startswith((*PLUMBING, "<frozen importlib")) or file in (importlib.__file__, "<string>")


def give_stack(fd: int) -> None:
    """Have this process write the stack of its main thread to ``fd`` when it crashes or receives ASK."""
    os.set_inheritable(fd, False)
    faulthandler.enable(fd, all_threads=False)
    faulthandler.register(ASK, fd, all_threads=False)


def read_stack(fd: int, *, patience_s: float) -> str:
    """Return the frames that came through the pipe within ``patience_s`` [s], most recent call last."""
    written, wait_s, until = b"", patience_s, time.monotonic() + patience_s + WHOLE_S
    while len(written) < MOST_BYTES and time.monotonic() < until and readable_descriptors([fd], wait_s):
        piece = os.read(fd, MOST_BYTES)
        if not piece:
            break
        written, wait_s = written + piece, PAUSE_S
    # Lines of source are left out: the process chose these file names, and reading such a file might block.
    last = written.decode(errors="replace").rpartition("(most recent call first)")[2]
    frames = [found.groups() for line in last.splitlines() if (found := _FRAME.fullmatch(line))]
    return "\n".join(
        f'  File "{file}", line {number}, in {name}' for file, number, name in reversed(frames) if not is_plumbing(file)
    )


def kill_children(statuses: dict[int, int | None]) -> None:
    """Send SIGKILL to all children of this process, and to those that it adopts meanwhile, until none is left or
    CHILDREN_PATIENCE_S is over. If this process adopts orphans, every descendant becomes a child when its parent ends.
    """
    until = time.monotonic() + CHILDREN_PATIENCE_S
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
    """Wait until this process has no child that lives, such as one that removes files; return whether that is so."""
    until = time.monotonic() + most_s
    while True:
        with suppress(ChildProcessError):
            reap({})
        if not _children() or time.monotonic() > until:
            return not _children()
        time.sleep(0.05)


def reap(statuses: dict[int, int | None], *, most: int = 256) -> bool:
    """Reap up to ``most`` children that have ended, since they can end faster than that; return whether there may be
    more of them. Fill in the exit statuses of those ids that ``statuses`` holds.

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
        for task in Path("/proc/self/task").iterdir():
            found.update(map(int, (task / "children").read_text().split()))
    return found
