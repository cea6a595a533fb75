"""Sockets with a path, which Landlock can close only from Linux 7.1 on. Programs of the user listen there, and some
start other programs, unisolated, for anyone who connects: the user's systemd, Docker, tmux."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

from carecontact.hosting.isolation.landlock import RESOLVE_SOCKET, SINCE, version

LISTENS = 1 << 16
"""linux/net.h: __SO_ACCEPTCON, among the flags of /proc/net/unix."""


def open_sockets(table: Path = Path("/proc/net/unix")) -> list[str]:
    """Return the paths of listening sockets that this user may connect to and not every user may.

    An isolated policy may connect to them as well.
    """
    if version() >= min(since for since, right in SINCE.items() if right == RESOLVE_SOCKET):
        return []
    found: set[str] = set()
    with suppress(OSError):
        for line in table.read_text(errors="replace").splitlines()[1:]:
            fields = line.split(maxsplit=7)
            if len(fields) == 8 and fields[7].startswith("/") and int(fields[3], 16) & LISTENS:
                found.add(fields[7])
    return sorted(path for path in found if _own(path))


def _own(path: str) -> bool:
    with suppress(OSError):
        at = os.stat(path)
        shared = at.st_mode & stat.S_IWGRP and at.st_gid in (os.getegid(), *os.getgroups())
        return at.st_uid == os.geteuid() or bool(shared)
    return False
