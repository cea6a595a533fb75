"""Recognizes the errors of the system that say nothing about a trial: no further process, thread or memory, or a file
system without locks."""

from __future__ import annotations

import errno

from carecontact.errors import ExhaustedError

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
        if isinstance(seen, ExhaustedError | MemoryError):
            return True
        if isinstance(seen, OSError) and seen.errno in NO_MORE:
            return True
        if isinstance(seen, RuntimeError) and NO_THREAD in str(seen):
            return True
        seen = seen.__cause__ or seen.__context__
    return False
