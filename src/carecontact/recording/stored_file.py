"""The HDF5 side of a trial file: what may be opened, and whether it is damaged before anything is unpacked."""

from __future__ import annotations

import errno
import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import CarecontactError, RecordingError
from carecontact.recording.schema import STORABLE_KINDS
from carecontact.recording.writer import CHECKSUM, HEADER

MAX_FILE_BYTES = 4 << 30
MAX_ARRAY_BYTES = 1 << 30
"""Largest size of all arrays together, as declared and before any is unpacked: a few hundred bytes can claim terabytes.
A whole trial of bathing-v3-draft has 13 MB."""
MAX_EXPANSION = 1100
"""Declared over stored bytes of one array; deflate reaches at most 1032."""
FREE_BYTES = 1 << 16
"""An array this small may have any expansion."""
MAX_CHUNK_BYTES = 256 << 20
MAX_HEADER_BYTES = 16 << 20
MAX_ARRAYS = 100_000
MAX_STRUCTURE_BYTES, STRUCTURE_BYTES_PER_ARRAY = 1 << 20, 1 << 10
"""Most bytes of a file beside its arrays, in all and for each array; no checksum covers them. A trial has 20 to 40 kB,
some 400 bytes for each array."""
NOT_ITS_FAULT = frozenset({
    errno.EACCES, errno.EPERM, errno.EIO, errno.ESTALE, errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EMFILE,
    errno.ENFILE, errno.ENOMEM, errno.ETIMEDOUT, errno.ENOTCONN, errno.EHOSTDOWN,
})  # fmt: skip
"""Numbers of errors that say something about the machine or a mount, and nothing about the content of a file."""
LOCKING = "HDF5_USE_FILE_LOCKING"
"""Variable that overrides what HDF5 is told about locks."""


@contextmanager
def opened(path: Path) -> Generator[Any]:
    """The h5py file of a trial, whose length HDF5 compares with the one that it stored.

    It is not locked: nobody changes a finished recording, and some file systems have no locks.

    Raises RecordingError naming the file for one that is absent, too large, truncated or not HDF5, and for any error
    inside the block that is not carecontact's own; OSError naming it where the machine fails to read it.
    """
    h5py: Any = import_module("h5py")  # ships no types
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: this is a folder; name one recording (.h5) in it")
        if not path.is_file():
            raise RecordingError(f"{path}: no such file")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise RecordingError(
                f"{path}: {path.stat().st_size} bytes, more than the {MAX_FILE_BYTES} a trial may have"
            )
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except CarecontactError:
        raise
    except OSError as error:
        if error.errno not in NOT_ITS_FAULT:
            raise _damaged(path, error) from None
        told = os.strerror(error.errno)
        if "lock file" in str(error):
            told += f"; {LOCKING}={os.environ.get(LOCKING)} demands locks that its file system lacks: unset it"
        raise OSError(error.errno, told, str(path)) from None
    except Exception as error:  # h5py answers damage with OSError, KeyError, RuntimeError, ValueError, TypeError ...
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> RecordingError:
    message = " ".join(str(error).split()) or type(error).__name__
    return RecordingError(f"{path}: not a readable HDF5 file; it is truncated, damaged, or not a recording: {message}")


def root_datasets(path: Path, file: Any) -> dict[str, Any]:
    """Return the header and the stored checksum, of the kind and size that they may have, without a look at the
    arrays."""
    h5py: Any = import_module("h5py")
    found: dict[str, Any] = {}
    for name in (HEADER, CHECKSUM):
        if isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Dataset):
            found[name] = file[name]
    check_sizes(path, found)
    return found


def find_datasets(path: Path, file: Any) -> dict[str, Any]:
    h5py: Any = import_module("h5py")
    found: dict[str, Any] = {}
    folders: list[tuple[str, Any]] = [("", file)]
    while folders:
        prefix, group = folders.pop()
        if len(found) + len(folders) > MAX_ARRAYS or prefix.count("/") > 8:
            raise RecordingError(f"{path}: more than {MAX_ARRAYS} arrays or nested deeper than 8 groups")
        for name in list[str | bytes](group):  # bytes where a name is no text
            if isinstance(name, bytes) or not name.isascii() or not name.isprintable():
                raise RecordingError(f"{path}: unexpected array path {name!a} in {prefix or '/'}")
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise RecordingError(f"{path}: {prefix}{name} is a link; a recording is one self-contained file")
            item = group[name]
            if isinstance(item, h5py.Group):
                folders.append((f"{prefix}{name}/", item))
            elif isinstance(item, h5py.Dataset):
                found[prefix + name] = item
            else:
                raise RecordingError(f"{path}: {prefix}{name} is neither a group nor an array")
    return found


def check_structure(path: Path, found: Mapping[str, Any]) -> None:
    """Refuse a file with more beside its arrays than HDF5 needs: bytes that are appended or in a gap, or attributes."""
    beside = path.stat().st_size - sum(int(item.id.get_storage_size()) for item in found.values())
    most = MAX_STRUCTURE_BYTES + STRUCTURE_BYTES_PER_ARRAY * len(found)
    if beside > most:
        raise RecordingError(
            f"{path}: {beside} bytes beside the arrays, more than the {most} that their description may take; somebody "
            "added something to the file"
        )


def check_sizes(path: Path, found: Mapping[str, Any]) -> None:
    total = 0
    for name, item in found.items():
        if item.is_virtual or item.external:
            raise RecordingError(f"{path}: {name} is stored in another file; a recording is self-contained")
        if item.shape is None:
            raise RecordingError(f"{path}: {name} is an array without a shape")
        if item.dtype.kind not in STORABLE_KINDS:
            raise RecordingError(f"{path}: {name} has dtype {item.dtype}; only numbers and booleans are allowed")
        size = _bytes_of(item.shape, item.dtype)
        total += size
        if total > MAX_ARRAY_BYTES or (name == HEADER and size > MAX_HEADER_BYTES):
            raise RecordingError(f"{path}: {name} declares {size} bytes, more than a trial may have")
        stored = int(item.id.get_storage_size())
        if size > max(FREE_BYTES, MAX_EXPANSION * stored):
            raise RecordingError(f"{path}: {name} declares {size} bytes and holds {stored}; never written or damaged")
        if item.chunks and _bytes_of(item.chunks, item.dtype) > MAX_CHUNK_BYTES:
            raise RecordingError(f"{path}: {name} has chunks of {item.chunks}, more than {MAX_CHUNK_BYTES} bytes")


def _bytes_of(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    return int(np.prod(shape, dtype=object)) * dtype.itemsize


def read_bytes(path: Path, found: Mapping[str, Any], name: str) -> bytes:
    absent = [n for n in (HEADER, CHECKSUM) if n not in found]
    if absent:
        raise RecordingError(f"{path}: an HDF5 file, but not a carecontact recording: {' and '.join(absent)} missing")
    item = found[name]
    if item.dtype != np.uint8 or item.ndim != 1:
        raise RecordingError(f"{path}: {name} is {item.dtype} of shape {item.shape}, expected a row of bytes (uint8)")
    return load(path, name, item).tobytes()


def load(path: Path, name: str, item: Any) -> npt.NDArray[Any]:
    """Return an array of a file, read-only."""
    try:
        array = np.asarray(item[()])
        array.flags.writeable = False
        return array
    except OSError as error:  # of a checksum or a decompression that fails
        if error.errno in NOT_ITS_FAULT:
            raise
        raise RecordingError(f"{path}: {name} is truncated or damaged: {' '.join(str(error).split())}") from None
