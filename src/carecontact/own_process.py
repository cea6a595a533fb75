"""Requests of a process to the kernel about itself. Each does nothing on a system whose kernel lacks it."""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

SET_PARENT_DEATH_SIGNAL, SET_DUMPABLE, SET_CHILD_SUBREAPER = 1, 4, 36
"""linux/prctl.h"""
CAPSET = {"x86_64": 126, "aarch64": 91}
"""Machine -> number of the system call."""
CAPABILITY_VERSION = 0x20080522
"""linux/capability.h: two words for each set."""
KEPT_CAPABILITIES = 1 << 1
"""CAP_DAC_OVERRIDE: root in a container reads files of other users, such as those of a mounted folder."""


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process as soon as the one that started it is gone; end now if it is gone already.

    ``parent``: the id of that process. The kernel watches the thread that started this process.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SET_PARENT_DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent ends, so that it can be found and killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def hide_memory() -> None:
    """Hide memory, environment and open files of this process from other processes of the same user, and forbid
    tracing.

    Root is not affected. A debugger cannot attach any more, and the process leaves no core file.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SET_DUMPABLE, 0, 0, 0, 0)


def drop_capabilities() -> None:
    """Give up, permanently, what root may do beyond other users, except KEPT_CAPABILITIES.

    It is permanent because a process with no_new_privs gains nothing by starting another program.
    """
    number = CAPSET.get(os.uname().machine) if sys.platform == "linux" else None
    if number is not None and os.geteuid() == 0:
        header = struct.pack("=Ii", CAPABILITY_VERSION, 0)
        sets = struct.pack("=6I", KEPT_CAPABILITIES, KEPT_CAPABILITIES, 0, 0, 0, 0)
        ctypes.CDLL(None).syscall(number, header, sets)


def hide_options(arguments: Sequence[str]) -> None:
    """Erase the options of this process from /proc, where every user can read command lines: options name tasks and
    seeds.

    ``arguments``: the end of this process's command line.
    """
    if sys.platform != "linux":
        return
    first = next((n for n, argument in enumerate(arguments) if argument.startswith("-")), len(arguments))
    hidden = b"".join(os.fsencode(argument) + b"\0" for argument in arguments[first:])
    if hidden and Path("/proc/self/cmdline").read_bytes().endswith(hidden):
        # proc(5): field 49 is the end of the arguments in memory; the first field after the name is the third.
        end = int(Path("/proc/self/stat").read_text(errors="replace").rpartition(")")[2].split()[46])
        if end > len(hidden):
            ctypes.memset(end - len(hidden), 0, len(hidden))
