"""A temporary folder for each policy, so that one trial leaves nothing there for the next."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL

from carecontact.hosting.isolation.allowlist import SHARED_MEMORY

PREFIX = "carecontact-policy-"
BESIDE_SHARED_MEMORY = "/tmp"
"""Where the folders lie if TMPDIR is in shared memory, which every policy may read and write."""


@dataclass(frozen=True, kw_only=True)
class PrivateFolder:
    path: Path
    lock: int
    """Descriptor of the lock, which the kernel releases when this process ends in any way."""

    def remove(self) -> None:
        """Remove the folder and release the lock."""
        remove_folder(self.path)
        os.close(self.lock)


def remove_folder(path: Path) -> None:
    """Remove the folder of a policy, whatever that made in it."""
    with suppress(OSError):
        # This needs no file descriptor, where too many may be open.
        path.rmdir()
        return
    # A tree deeper than Python's stack raises, and a folder without the right to list it stays.
    with suppress(RecursionError):
        shutil.rmtree(path, ignore_errors=True)
    if path.exists():
        for command in (["chmod", "-R", "u+rwx"], ["rm", "-rf"]):
            with suppress(OSError):
                subprocess.run([*command, "--", path], stdin=DEVNULL, stderr=DEVNULL, check=False)


def private_folder() -> PrivateFolder:
    """Make a folder, after removing those whose harness is gone. Raises OSError if none can be made."""
    remove_abandoned_folders()
    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=_place()))
        # Between making and locking the folder, another harness may have removed it as an abandoned one.
        with suppress(FileNotFoundError, BlockingIOError):
            try:
                made = PrivateFolder(path=path, lock=_locked(path))
            except OSError as error:
                # Too many open files, for example: nobody would know this folder as abandoned before the next command.
                if not isinstance(error, FileNotFoundError | BlockingIOError):
                    path.rmdir()
                raise
            if path.is_dir():
                return made
            made.remove()


def remove_abandoned_folders() -> None:
    """Remove the folders of policies whose harness was killed."""
    for path in _place().glob(f"{PREFIX}*"):
        with suppress(OSError):
            PrivateFolder(path=path, lock=_locked(path)).remove()


def _place() -> Path:
    place = Path(tempfile.gettempdir()).resolve()
    return Path(BESIDE_SHARED_MEMORY) if place.is_relative_to(SHARED_MEMORY) else place


def _locked(path: Path) -> int:
    """Lock a folder and return the descriptor. Raises BlockingIOError while another process holds the lock."""
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise
    return lock
