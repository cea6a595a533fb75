"""What is said where a file cannot be stored for want of space."""

from __future__ import annotations

import errno
from pathlib import Path

from carecontact.errors import StorageError

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""A full device, a quota that is used up, and a limit on the size of files."""
REMEDY = "free some space there, then give the same command again"


def is_full(error: BaseException) -> bool:
    """Whether an error says that there is no space."""
    return isinstance(error, StorageError) or (isinstance(error, OSError) and error.errno in FULL)


def no_space(place: Path, why: str | None) -> StorageError:
    """``why``: what the system says, such as "No space left on device"."""
    return StorageError(f"{place}: {why or 'no space left'}; {REMEDY}")
