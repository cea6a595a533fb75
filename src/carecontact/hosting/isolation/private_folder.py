"""A temporary folder for each policy, so that one trial leaves nothing there for the next."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL
from typing import NoReturn

from carecontact.exhausted import NO_LOCKS
from carecontact.hosting.isolation.allowlist import SHARED_MEMORY

PREFIX = "carecontact-policy-"
BESIDE_SHARED_MEMORY = "/tmp"
"""Where the folders lie if TMPDIR is in shared memory, which every policy may read and write."""
REMOVAL_S = 10.0
"""Longest wait [s] for the removal of a policy's folder when the policy has ended: it may have left so many files that
this takes minutes, and then goes on beside the next trial."""
ABANDONED_S = 1.0
"""Longest wait [s] for the removal of folders that others left, which no policy's deadline may pay for."""
REMOVER = "care-remover"
"""Name of the process that removes folders. /proc shows it even after that process has ended."""
_REMOVE = f"""
{{ printf {REMOVER} > /proc/self/comm; }} 2> /dev/null
rm -rf -- "$@"
for folder; do
    # A folder without the right to list it.
    [ ! -e "$folder" ] || {{ chmod -R u+rwx -- "$folder"; rm -rf -- "$folder"; }}
done
"""

_removing: list[subprocess.Popen[bytes]] = []


@dataclass(frozen=True, kw_only=True)
class PrivateFolder:
    path: Path
    lock: int
    """Descriptor of the lock, which the kernel releases when the last process that has it ends in any way."""

    def remove(self) -> None:
        """Remove the folder, whatever a policy made in it, and release the lock. It may go on after REMOVAL_S."""
        _remove([self], wait_s=REMOVAL_S)

    def release(self) -> None:
        """Leave the folder to another process that has the lock."""
        os.close(self.lock)


def become_remover(path: Path) -> NoReturn:
    """Remove the folder of a policy and end this process, which turns into another program for that."""
    with suppress(OSError):
        path.rmdir()
        os._exit(0)
    with suppress(OSError):
        os.execvpe("sh", _remover([path]), {"PATH": os.environ.get("PATH", os.defpath)})
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
    _removing[:] = [process for process in _removing if process.poll() is None]
    abandoned: list[PrivateFolder] = []
    for path in _place().glob(f"{PREFIX}*"):
        with suppress(OSError):
            abandoned.append(PrivateFolder(path=path, lock=_locked(path)))
    _remove(abandoned, wait_s=ABANDONED_S)


def _remove(folders: Sequence[PrivateFolder], *, wait_s: float) -> None:
    left: list[PrivateFolder] = []
    for folder in folders:
        try:
            # This needs no file descriptor, where too many may be open.
            folder.path.rmdir()
        except FileNotFoundError:
            continue
        except OSError:
            left.append(folder)
    if left:
        with suppress(OSError):  # What cannot be removed now is found as abandoned later.
            process = subprocess.Popen(
                _remover([folder.path for folder in left]), pass_fds=[folder.lock for folder in left],
                stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL, start_new_session=True,
            )  # fmt: skip
            try:
                process.wait(wait_s)
            except subprocess.TimeoutExpired:
                _removing.append(process)
    for folder in folders:
        os.close(folder.lock)


def _remover(paths: Sequence[Path]) -> list[str]:
    return ["sh", "-c", _REMOVE, "sh", *map(str, paths)]


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
