"""What a process asks of the system."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import struct
import sys
from importlib import metadata
from pathlib import Path

from carecontact.errors import ExhaustedError

SET_PARENT_DEATH_SIGNAL, SET_CHILD_SUBREAPER, NO_NEW_PRIVILEGES = 1, 36, 38
"""linux/prctl.h"""
CAPSET = {"x86_64": 126, "aarch64": 91}
"""Machine -> number of the system call."""
CAPABILITY_VERSION = 0x20080522
"""linux/capability.h: two words for each set."""
KEPT_CAPABILITIES = 1 << 1
"""CAP_DAC_OVERRIDE: root in a container reads files of other users, such as those of a mounted folder."""


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process as soon as ``parent``, the process that started it, is gone."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SET_PARENT_DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent ends, so that it can be found and killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def drop_capabilities() -> None:
    """Give up for good what root may do beyond other users, except KEPT_CAPABILITIES, also in a namespace."""
    if sys.platform != "linux":
        return
    libc, number = ctypes.CDLL(None), CAPSET.get(os.uname().machine)
    # Then nothing is gained by starting another program.
    libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    if number is not None:
        left = KEPT_CAPABILITIES if os.geteuid() == 0 else 0
        header = struct.pack("=Ii", CAPABILITY_VERSION, 0)
        libc.syscall(number, header, struct.pack("=6I", left, left, 0, 0, 0, 0))


NO_MORE = frozenset({errno.EAGAIN, errno.ENOMEM})
"""Error numbers of fork(2): too many processes, among which threads count, or too little memory."""
NO_LOCKS = frozenset({errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL, errno.EBADF})
"""Error numbers of flock(2) where a file system has no locks. EINVAL comes from FUSE, and EBADF from NFS, which locks
only what is open for writing, and so no folder."""
NO_THREAD = "can't start new thread"
"""Message of the RuntimeError that ``threading.Thread.start`` raises."""
REMEDY = "end other programs or raise the limit (ulimit -u, Docker's --pids-limit), then give the same command again"


def is_exhausted(error: BaseException) -> bool:
    """Whether an error, or one that led to it, says that something is used up."""
    seen: BaseException | None = error
    while seen is not None:
        if (
            isinstance(seen, ExhaustedError | MemoryError)
            or (isinstance(seen, OSError) and seen.errno in NO_MORE)
            or (isinstance(seen, RuntimeError) and NO_THREAD in str(seen))
        ):
            return True
        seen = seen.__cause__ or seen.__context__
    return False


def installed_version(package: str) -> str | None:
    """Return the version of a distribution; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


CACHE_VARIABLE = "CARECONTACT_CACHE"
"""Environment variable with the path of the folder of kept files; if it is empty, nothing is kept."""


def cache_folder() -> Path | None:
    """Return the folder of kept files; None if nothing is to be kept, or the user has no home folder."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # HOME is not set, and the system knows no home folder of this user.
        return None
    return Path(base) / "carecontact"
