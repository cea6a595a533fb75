"""A filter of system calls (seccomp) against what Landlock leaves open: setting the resource limits of another process
of the same user, by which a policy could have the kernel kill the trial's process or keep it from writing its
recording.

Numbers are those of linux/seccomp.h, linux/filter.h, linux/audit.h and of each architecture's table of system calls."""

from __future__ import annotations

import ctypes
import errno
import os
import struct
import sys

NO_NEW_PRIVS, SET_SECCOMP = 38, 22
"""linux/prctl.h"""
FILTER, GET_ACTION_AVAIL = 2, 2
SECCOMP = {"x86_64": 317, "aarch64": 277}
"""Machine -> number of the system call."""
PRLIMIT = {
    "x86_64": ((0xC000003E, 302), (0xC000003E, 302 | 1 << 30), (0x40000003, 340)),
    "aarch64": ((0xC00000B7, 261), (0x40000028, 369)),
}
"""Machine -> the architectures whose programs it runs, with their number of ``prlimit64``. The second one is x32."""
LOAD, EQUAL, RETURN = 0x20, 0x15, 0x06
CALL_AT, ARCHITECTURE_AT, FIRST_ARGUMENT_AT = 0, 4, 16
"""Offsets in ``struct seccomp_data``."""
REFUSE, ALLOW = 0x00050000 | errno.EPERM, 0x7FFF0000


def can_close_limits() -> bool:
    """Whether this system filters system calls."""
    number = SECCOMP.get(os.uname().machine) if sys.platform == "linux" else None
    action = ctypes.byref(ctypes.c_uint32(REFUSE & 0xFFFF0000))
    return number is not None and ctypes.CDLL(None).syscall(number, GET_ACTION_AVAIL, 0, action) == 0


def close_limits() -> bool:
    """Refuse ``prlimit`` for every process other than the caller, which calls itself 0. Return whether that worked.

    The filter applies to the calling thread and to all that it starts, so call this before there is another thread.
    """
    if not can_close_limits():
        return False
    steps = b"".join(_block(*each) for each in PRLIMIT[os.uname().machine]) + _step(RETURN, ALLOW)
    code = ctypes.create_string_buffer(steps, len(steps))
    program = struct.pack("@HP", len(steps) // 8, ctypes.addressof(code))
    prctl = ctypes.CDLL(None).prctl
    return prctl(NO_NEW_PRIVS, 1, 0, 0, 0) == 0 and prctl(SET_SECCOMP, FILTER, program, 0, 0) == 0


def _block(architecture: int, number: int) -> bytes:
    """Return the seven instructions that refuse one system call if its first argument is not 0.

    Otherwise, the instructions after them are executed.
    """
    return b"".join(
        (
            _step(LOAD, ARCHITECTURE_AT), _step(EQUAL, architecture, otherwise=5),
            _step(LOAD, CALL_AT), _step(EQUAL, number, otherwise=3),
            _step(LOAD, FIRST_ARGUMENT_AT), _step(EQUAL, 0, then=1), _step(RETURN, REFUSE),
        )
    )  # fmt: skip


def _step(code: int, value: int, *, then: int = 0, otherwise: int = 0) -> bytes:
    """Return one instruction. ``then``, ``otherwise``: number of instructions to skip after a comparison."""
    return struct.pack("=HBBI", code, then, otherwise, value)
