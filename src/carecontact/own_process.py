"""Requests of a process to the kernel about itself. Each does nothing on a system whose kernel lacks it."""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys

SET_PARENT_DEATH_SIGNAL, SET_CHILD_SUBREAPER, NO_NEW_PRIVILEGES = 1, 36, 38
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


def drop_capabilities() -> None:
    """Give up, permanently, what root may do beyond other users, except KEPT_CAPABILITIES, and what another user may do
    in a namespace of its own.
    """
    if sys.platform != "linux":
        return
    libc, number = ctypes.CDLL(None), CAPSET.get(os.uname().machine)
    # Then nothing is gained by starting another program.
    libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    if number is not None:
        left = KEPT_CAPABILITIES if os.geteuid() == 0 else 0
        header = struct.pack("=Ii", CAPABILITY_VERSION, 0)
        libc.syscall(number, header, struct.pack("=6I", left, left, 0, 0, 0, 0))
