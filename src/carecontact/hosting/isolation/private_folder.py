"""A temporary folder on the disk for each policy, where its temporary files are not in a namespace's memory."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from carecontact.exhausted import NO_LOCKS
from carecontact.hosting.isolation.namespaces import SHARED_MEMORY

PREFIX = "carecontact-policy-"
BESIDE_SHARED_MEMORY = "/tmp"
"""Where the folders lie if TMPDIR is in shared memory, which every policy may read and write."""
REMOVAL_S = 10.0
"""Longest wait [s] for the removal of a policy's folder when the policy has ended: it may have left so many files that
this takes minutes, and then goes on beside the next trial."""
ABANDONED_S = 1.0
"""Longest wait [s] for the removal of all folders that killed harnesses left: the deadline of another policy pays for
it."""
# The second attempt is for a folder without the right to list it.
_REMOVE = ("sh", "-c", 'rm -rf -- "$0" 2>/dev/null || { chmod -R u+rwx -- "$0"; rm -rf -- "$0"; }')


@dataclass(frozen=True, kw_only=True)
class PrivateFolder:
    path: Path
    lock: int
    """Descriptor of the lock, which the kernel releases when the last process that has it ends in any way."""

    def remove(self, *, wait_s: float = REMOVAL_S) -> None:
        """Remove the folder, whatever a policy made in it, and release the lock. It may go on after the wait."""
        try:
            self.path.rmdir()  # This needs no file descriptor, where too many may be open.
        except FileNotFoundError:
            pass
        except OSError:
            # What cannot be removed now is found as abandoned later.
            with suppress(OSError, subprocess.TimeoutExpired):
                subprocess.Popen([*_REMOVE, str(self.path)], pass_fds=[self.lock], start_new_session=True).wait(wait_s)
        self.release()

    def release(self) -> None:
        """Leave the folder to another process that has the lock."""
        os.close(self.lock)


def remove_and_exit(path: Path) -> NoReturn:
    """Remove the folder of a policy and end this process, which turns into another program for that."""
    with suppress(OSError):
        path.rmdir()
        os._exit(0)
    with suppress(OSError):
        os.execvpe(_REMOVE[0], [*_REMOVE, str(path)], {"PATH": os.environ.get("PATH", os.defpath)})
    shutil.rmtree(path, ignore_errors=True)
    os._exit(0)


def private_folder() -> PrivateFolder:
    """Make a folder, after removing those whose harness is gone. Raises OSError if none can be made.

    Where the file system has no locks, nobody can tell an abandoned folder from one in use: it is left there.
    """
    remove_abandoned_folders()
    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=_place()))
        # Between making and locking the folder, another harness may have removed it as an abandoned one.
        with suppress(FileNotFoundError, BlockingIOError):
            try:
                made = PrivateFolder(path=path, lock=_locked(path, otherwise_open=True))
            except OSError as error:
                # Too many open files, for example: nobody would know this folder as abandoned before the next command.
                if not isinstance(error, FileNotFoundError | BlockingIOError):
                    path.rmdir()
                raise
            if path.is_dir():
                return made
            made.remove()


def remove_abandoned_folders() -> None:
    """Remove the folders of policies whose harness was killed. It may go on after ABANDONED_S."""
    until = time.monotonic() + ABANDONED_S
    for path in _place().glob(f"{PREFIX}*"):
        with suppress(OSError):
            PrivateFolder(path=path, lock=_locked(path)).remove(wait_s=max(0.0, until - time.monotonic()))


def _place() -> Path:
    place = Path(tempfile.gettempdir()).resolve()
    return Path(BESIDE_SHARED_MEMORY) if place.is_relative_to(SHARED_MEMORY) else place


def _locked(path: Path, *, otherwise_open: bool = False) -> int:
    """Lock a folder and return the descriptor. Raises BlockingIOError while another process holds the lock.

    Args:
        otherwise_open: whether to return it without a lock where the file system has none.
    """
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if not (otherwise_open and error.errno in NO_LOCKS):
            os.close(lock)
            raise
    return lock
