"""The Python stack of a policy's process, which the interpreter writes on a signal and when it crashes."""

from __future__ import annotations

import faulthandler
import importlib
import os
import re
import signal
import time
from pathlib import Path

import carecontact
from carecontact.hosting.readable import readable

ASK = signal.SIGQUIT
"""The signal that asks a process for its stack, as in Java and Go."""
PATIENCE_S = 1.0
"""Longest wait [s] for the stack; a process that was stopped by a signal gives none."""
PAUSE_S = 0.1
"""If no further line comes for this time [s], the stack is complete."""
WHOLE_S = 1.0
"""Longest time [s] from the first line to the last: the policy can write there, too, and go on and on."""
MOST_BYTES = 65536
PLUMBING = tuple(f"{Path(carecontact.__file__).parent / folder}{os.sep}" for folder in ("hosting", "contract"))
"""Folders whose code calls every policy or checks its values, and therefore explains no mistake of a policy."""
_FRAME = re.compile(r'  File "(.+)", line (\d+) in (.+)')
_BEGINS = "(most recent call first)"


def is_plumbing(file: str) -> bool:
    """Whether frames of this file belong to the harness, which calls the policy, checks its values or imports its
    module.
    """
    return file.startswith((*PLUMBING, "<frozen importlib")) or file in (importlib.__file__, "<string>")


def give_stack(fd: int) -> None:
    """Have this process write the stack of its main thread to ``fd`` when it crashes or receives ASK."""
    os.set_inheritable(fd, False)
    faulthandler.enable(fd, all_threads=False)
    faulthandler.register(ASK, fd, all_threads=False)


def read_stack(fd: int, *, patience_s: float) -> str:
    """Return the frames that came through the pipe, one on each line, most recent call last; empty if none came.

    Args:
        patience_s: how long to wait for the first of them.
    """
    written, wait_s, until = b"", patience_s, time.monotonic() + patience_s + WHOLE_S
    while len(written) < MOST_BYTES and time.monotonic() < until and readable([fd], wait_s):
        piece = os.read(fd, MOST_BYTES)
        if not piece:
            break
        written, wait_s = written + piece, PAUSE_S
    # Lines of source are left out: the process chose these file names, and reading such a file might block.
    last = written.decode(errors="replace").rpartition(_BEGINS)[2]
    frames = [found.groups() for line in last.splitlines() if (found := _FRAME.fullmatch(line))]
    return "\n".join(
        f'  File "{file}", line {number}, in {name}' for file, number, name in reversed(frames) if not is_plumbing(file)
    )
