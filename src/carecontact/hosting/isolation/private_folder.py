"""A temporary folder for each policy, so that one trial leaves nothing there for the next."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

PREFIX = "carecontact-policy-"


@dataclass(frozen=True, kw_only=True)
class PrivateFolder:
    path: Path
    lock: int
    """Descriptor; the kernel gives the lock back when this process is gone, however it ended."""

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self.lock)


def private_folder() -> PrivateFolder:
    """Make one, after removing those whose harness is gone. Raises OSError where none can be made."""
    remove_abandoned_folders()
    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX))
        # Between the two lines another harness may have taken it for an abandoned one.
        with suppress(FileNotFoundError, BlockingIOError):
            made = PrivateFolder(path=path, lock=_locked(path))
            if path.is_dir():
                return made
            made.remove()


def remove_abandoned_folders() -> None:
    """Remove the folders of policies whose harness was killed."""
    for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):
            PrivateFolder(path=path, lock=_locked(path)).remove()


def _locked(path: Path) -> int:
    """Raises BlockingIOError while another process holds it."""
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise
    return lock
