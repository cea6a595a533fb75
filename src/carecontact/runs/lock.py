"""One command at a time writes into a run's folder.

A lock of the kernel ensures this. Where the file system has none, as some NFS mounts, the file of the lock itself does:
who creates it has the folder. Then the kernel does not free the folder of a command that was killed.
"""

from __future__ import annotations

import fcntl
import os
import platform
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from carecontact.errors import ConfigError
from carecontact.recording.file import is_full, no_space
from carecontact.system import NO_LOCKS

LOCK = ".lock"
_held = set[tuple[int, int]]()
"""Device and inode of the files that this process has locked."""


@contextmanager
def folder_lock(folder: Path, *, make: bool = False) -> Generator[None]:
    """Keep every other command out of a folder inside the block; the kernel ends this in every exit of the process,
    where it can. The commands of one process may nest. A folder that was made for this and stays empty goes again;
    without ``make``, nothing is locked in the place of a folder that is not there."""
    try:
        str(folder.resolve()).encode()
    except UnicodeEncodeError:
        raise ConfigError(f"{str(folder.resolve())!a} holds bytes that are not UTF-8; rename it") from None
    made = False
    try:
        made = make and not folder.exists()
        stream = _locked(folder, make=make) if make or folder.exists() else None
    except NotADirectoryError:
        stream = None  # a file, of which the command will say more
    except OSError as error:
        with suppress(OSError):
            if made:
                folder.rmdir()
        if is_full(error):
            raise no_space(folder, error.strerror) from None
        raise ConfigError(f"{folder}: cannot be written to: {error.strerror}") from None
    if stream is None:
        yield
        return
    with stream:
        mine = _inode(stream.fileno())
        _held.add(mine)
        try:
            yield
        finally:
            _held.discard(mine)
            with suppress(OSError):
                # Before the lock goes, and never the file of another: the folder may have been moved and made again.
                if _inode(folder / LOCK) == mine:
                    (folder / LOCK).unlink()
                if made:
                    folder.rmdir()


def _locked(folder: Path, *, make: bool) -> TextIO | None:
    """Return the open and locked file, or None where this process has it already."""
    path = folder / LOCK
    while True:
        if make and not folder.exists():
            # Also again: another command that made the folder removes it if it stays empty.
            folder.mkdir(parents=True, exist_ok=True)
        try:
            stream, created = path.open("x+"), True
        except FileExistsError:
            try:
                stream, created = path.open("r+"), False
            except FileNotFoundError:
                continue  # The command that had it has just removed it.
        except FileNotFoundError:
            if not make:
                raise
            continue
        if _inode(stream.fileno()) in _held:
            stream.close()
            return None
        unlocked = ""
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _held_by(stream, folder) from None
        except OSError as error:
            if error.errno not in NO_LOCKS:
                stream.close()
                raise
            if not created:
                freed = f"; if it was killed, delete {path}, since this file system has no locks ({error.strerror})"
                raise _held_by(stream, folder, freed) from None
            unlocked = f" of {platform.node()}"
        # The command that had it may have removed the file between our opening and our locking it.
        with suppress(FileNotFoundError):
            if _inode(path) == _inode(stream.fileno()):
                break
        stream.close()
    try:
        stream.truncate(0)
        since = time.strftime("%Y-%m-%d %H:%M:%S")
        os.write(stream.fileno(), f"process {os.getpid()}{unlocked}, since {since},".encode())
    except BaseException:
        with suppress(OSError):
            path.unlink()
        stream.close()
        raise
    return stream


def _held_by(stream: TextIO, folder: Path, remedy: str = "") -> ConfigError:
    with stream:
        stream.seek(0)
        holder = stream.read(200).strip() or "another command"
    return ConfigError(f"{folder}: {holder} is at work in this folder; wait until it has ended{remedy}")


def _inode(file: Path | int) -> tuple[int, int]:
    status = os.stat(file)
    return status.st_dev, status.st_ino
