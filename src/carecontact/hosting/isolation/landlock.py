"""Landlock: a process gives up rights to files and signals for itself and its descendants, without needing a privilege.
Numbers are those of linux/landlock.h."""

from __future__ import annotations

import ctypes
import os
import stat
import struct
import sys
from collections.abc import Mapping
from contextlib import suppress

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
"""System calls, with the same numbers on every architecture that Python runs on."""
VERSION_FLAG, PATH_BENEATH = 1, 1
NO_NEW_PRIVS = 38
"""linux/prctl.h"""

EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
REMOVE_AND_MAKE = sum(1 << bit for bit in range(4, 13))
"""Remove a directory or file; make a device, directory, file, socket, pipe or link."""
REFER, TRUNCATE, IOCTL_DEVICE, RESOLVE_SOCKET = 1 << 13, 1 << 14, 1 << 15, 1 << 16
"""Rights of later versions. The last one is to connect to a socket with a path that another process made."""
SINCE = {2: REFER, 3: TRUNCATE, 5: IOCTL_DEVICE, 9: RESOLVE_SOCKET}
"""Version of Landlock -> the right that this version is the first to control."""
SCOPES_SINCE, ABSTRACT_SOCKETS, SIGNALS = 6, 1 << 0, 1 << 1

READ = EXECUTE | READ_FILE | READ_DIR
WRITE = WRITE_FILE | REMOVE_AND_MAKE | REFER | TRUNCATE
DEVICE = READ_FILE | WRITE_FILE | IOCTL_DEVICE
OF_A_FILE = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEVICE | RESOLVE_SOCKET
"""Rights that a rule about anything other than a directory may contain."""

_PINNED: list[int] = []
"""Open descriptors of the places in /proc that rules name. Without them, the kernel may recreate such a place, and the
rule would no longer apply to it."""


def version() -> int:
    """Return the kernel's version of Landlock, 0 where it has none or forbids it."""
    if sys.platform != "linux":
        return 0
    return max(_call(CREATE_RULESET, None, 0, VERSION_FLAG), 0)


def restrict(rights: Mapping[str, int]) -> int:
    """Take from this process every right to files that ``rights`` (path -> rights beneath it) does not give.

    It also takes signals and abstract sockets to processes that this process did not start. The restriction applies to
    the calling thread and to those that it starts, so call it before there is another thread. Paths that do not exist
    are skipped. Returns the kernel's version of Landlock; 0 means that nothing was restricted.
    """
    kernel = version()
    if not kernel:
        return 0
    handled = READ | WRITE_FILE | REMOVE_AND_MAKE | sum(right for since, right in SINCE.items() if kernel >= since)
    scopes = ABSTRACT_SOCKETS | SIGNALS if kernel >= SCOPES_SINCE else 0
    return kernel if _enter(handled, rights, scopes=scopes) else 0


def _enter(handled: int, rights: Mapping[str, int], *, scopes: int) -> bool:
    # An older kernel refuses unknown fields unless they are 0.
    attributes = struct.pack("=QQQ", handled, 0, scopes)
    ruleset = _call(CREATE_RULESET, attributes, len(attributes), 0)
    if ruleset < 0:
        return False
    try:
        for path, allowed in rights.items():
            with suppress(OSError):
                _add(ruleset, path, allowed & handled)
        no_new_privileges = ctypes.CDLL(None).prctl(NO_NEW_PRIVS, 1, 0, 0, 0) == 0
        return no_new_privileges and _call(RESTRICT_SELF, ruleset, 0) == 0
    finally:
        os.close(ruleset)


def _add(ruleset: int, path: str, allowed: int) -> None:
    place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        if not stat.S_ISDIR(os.fstat(place).st_mode):
            allowed &= OF_A_FILE
        if allowed:
            _call(ADD_RULE, ruleset, PATH_BENEATH, struct.pack("=Qi", allowed, place), 0)
    finally:
        if path.startswith("/proc/"):
            _PINNED.append(place)
        else:
            os.close(place)


def _call(number: int, *arguments: int | bytes | None) -> int:
    """Make a system call. A number is passed as a long, because the kernel reads all 64 bits of some arguments."""
    passed = [ctypes.c_long(a) if isinstance(a, int) else a for a in arguments]
    libc = ctypes.CDLL(None)
    libc.syscall.restype = ctypes.c_long
    return libc.syscall(ctypes.c_long(number), *passed)
