"""Writes a recording once and reads it back verified."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import tempfile
from collections.abc import Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from carecontact.errors import CarecontactError, RecordingError, StorageError
from carecontact.recording.pictures import FILM
from carecontact.recording.provenance import missing_suppliers
from carecontact.recording.schema import (
    STORABLE_KINDS,
    WALL_CLOCK,
    Header,
    Recording,
    check_header,
    check_recording,
    check_version,
)

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""A full device, a quota that is used up, and a limit on the size of files."""
REMEDY = "free some space there, then give the same command again"


def is_full(error: BaseException) -> bool:
    """Whether an error says that there is no space."""
    return isinstance(error, StorageError) or (isinstance(error, OSError) and error.errno in FULL)


def no_space(place: Path, why: str | None) -> StorageError:
    """``why``: what the system says, such as "No space left on device"."""
    return StorageError(f"{place}: {why or 'no space left'}; {REMEDY}")


def header_json(header: Header) -> bytes:
    """Return one spelling of a header. A field that headers did not always have is left out at its default."""
    left_out = {name for name in ("origin",) if getattr(header, name) == Header.model_fields[name].default}
    content = header.model_dump(mode="json", exclude=left_out)
    return json.dumps(content, sort_keys=True, separators=(",", ":")).encode("ascii")


def little_endian(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the same values, contiguous and little-endian, as stored and as hashed."""
    return np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(array.shape)


def canonical_hash(recording: Recording) -> str:
    """SHA-256 (hex) of header and arrays, independent of file layout and compression.

    Covers every array but those under ``wall/``, so two runs of one deterministic trial hash alike. A recording that
    was read from a file has the hash that was verified then.
    """
    return recording.stored_sha256 or canonical_digest(header_json(recording.header), recording.arrays)


def canonical_digest(header: bytes, arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """``canonical_hash`` of a header as it is spelled in a file."""
    digest = hashlib.sha256()

    def add(part: bytes) -> None:
        digest.update(len(part).to_bytes(8, "little"))  # without lengths, neighbouring parts could trade bytes
        digest.update(part)

    add(header)
    for path in sorted(arrays):
        if path.startswith(WALL_CLOCK):
            continue
        array = little_endian(arrays[path])
        add(path.encode())
        add(array.dtype.str.encode())
        add(repr(tuple(int(n) for n in array.shape)).encode())
        digest.update(array.nbytes.to_bytes(8, "little"))
        digest.update(array.reshape(-1).view(np.uint8).data)  # as add does, without copying
    return digest.hexdigest()


HEADER, CHECKSUM = "header_json", "sha256"
"""Datasets of bytes at the file's root: the header, and the canonical hash of everything else."""
TEMPORARY = ".tmp"
"""Ending of a hidden file that is not whole yet."""
GZIP_LEVEL = 1
"""Level 4, h5py's own, takes a quarter longer for files that are 6 % smaller."""
CHUNKED_FROM_BYTES = 1024
CHUNK_BYTES = 1 << 18
"""Size of a chunk of whole rows: h5py's own guess cuts columns apart, and reading a trial takes twice as long."""


def write_recording(recording: Recording, path: Path | str) -> Path:
    """Write a recording, replacing ``path`` when every byte is on disk. Raises StorageError where there is no space."""
    h5py: Any = import_module("h5py")  # ships no types
    path = Path(path)
    header = header_json(recording.header)
    # v110 metadata is checksummed by the library itself, so a damaged file fails instead of reading as something else.
    with h5py.File(path.name, "w", driver="core", backing_store=False, libver=("v110", "v110")) as file:
        file.create_dataset(HEADER, data=np.frombuffer(header, np.uint8), fletcher32=True)
        digest = np.frombuffer(bytes.fromhex(canonical_digest(header, recording.arrays)), np.uint8)
        file.create_dataset(CHECKSUM, data=digest, fletcher32=True)
        for name in sorted(recording.arrays):
            array, more = little_endian(recording.arrays[name]), {}
            if array.nbytes >= CHUNKED_FROM_BYTES:
                rows = max(1, min(len(array), CHUNK_BYTES // max(1, array[0].nbytes)))
                more = {"chunks": (rows, *array.shape[1:]), "fletcher32": True}
                if not name.startswith(FILM):  # which is compressed already
                    more |= {"compression": "gzip", "compression_opts": GZIP_LEVEL, "shuffle": True}
            file.create_dataset(name, data=array, **more)
        file.flush()
        image: bytes = file.id.get_file_image()
    replace_file(path, image)
    return path


def replace_file(path: Path, content: bytes) -> None:
    """Replace a file atomically, also in a crash. Raises StorageError where there is no space, and leaves nothing."""
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except BaseException as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError) and is_full(error):
            raise no_space(path, error.strerror) from None
        raise


MAX_FILE_BYTES = 4 << 30
MAX_ARRAY_BYTES = 1 << 30
"""Largest size of all arrays together, as declared and before any is unpacked: a few hundred bytes can claim terabytes.
A whole trial of bathing-v3 has 13 MB."""
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
NOT_ITS_FAULT = {
    *(errno.EACCES, errno.EPERM, errno.EIO, errno.ESTALE, errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS),
    *(errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ETIMEDOUT, errno.ENOTCONN, errno.EHOSTDOWN),
}
"""Numbers of errors that say something about the machine or a mount, and nothing about the content of a file."""
LOCKING = "HDF5_USE_FILE_LOCKING"
"""Variable that overrides how HDF5 locks its files."""


@contextmanager
def opened(path: Path) -> Generator[Any]:
    """The h5py file of a trial, not locked. Raises RecordingError for its faults, OSError for the machine's."""
    h5py: Any = import_module("h5py")  # ships no types
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: this is a folder; name one recording (.h5) in it")
        if not path.is_file():
            raise RecordingError(f"{path}: no such file")
        if (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise RecordingError(f"{path}: {size} bytes, more than the {MAX_FILE_BYTES} a trial may have")
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except CarecontactError:
        raise
    except OSError as error:
        if error.errno not in NOT_ITS_FAULT:
            raise _damaged(path, error) from None
        why = os.strerror(error.errno)
        if "lock file" in str(error):
            why += f"; {LOCKING}={os.environ.get(LOCKING)} demands locks that its file system lacks: unset it"
        raise OSError(error.errno, why, str(path)) from None
    except Exception as error:  # h5py answers damage with OSError, KeyError, RuntimeError, ValueError, TypeError ...
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> RecordingError:
    message = " ".join(str(error).split()) or type(error).__name__
    return RecordingError(f"{path}: not a readable HDF5 file; it is truncated, damaged, or not a recording: {message}")


def root_datasets(path: Path, file: Any) -> dict[str, Any]:
    """Return header and stored checksum, checked for kind and size, without a look at the arrays."""
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
    if absent := [n for n in (HEADER, CHECKSUM) if n not in found]:
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


def read_recording(path: Path | str) -> Recording:
    """Read one trial file whole and verify it. Nothing has to check the result again, and its arrays are read-only.

    Raises RecordingError naming the file and the fault: absent, not HDF5, truncated, damaged, foreign, too large,
    another schema, a required array missing or of the wrong dtype or shape, or a checksum that differs. Raises
    ConfigError for an installed action or region that its protocol names and that cannot be loaded.
    """
    path = Path(path)
    with opened(path) as file:
        found = find_datasets(path, file)
        check_sizes(path, found)
        check_structure(path, found)
        stored, content = read_bytes(path, found, CHECKSUM), read_bytes(path, found, HEADER)
        header = _header_in(path, content)
        # As declared, before anything is unpacked: arrays that contradict each other cost no memory.
        check_recording(header, _arrays_in(found), str(path))
        arrays = {name: load(path, name, item) for name, item in _arrays_in(found).items()}
    # Over the bytes that were written: a header that this release would spell differently is still the same.
    actual = canonical_digest(content, arrays)
    if actual != stored.hex():
        raise RecordingError(
            f"{path}: checksum {actual[:12]}... differs from the stored {stored.hex()[:12]}...: damaged"
        )
    return Recording.trusted(header, MappingProxyType(arrays), sha256=actual)


def open_recording(path: Path | str, *, sha256: str = "") -> Recording:
    """Return the recording of a file that was verified before: by the process that wrote it just now, or by the one
    that scored it. Each array is read when it is used, and the file stays open as long as the recording is there.

    Verifies what ``read_header`` verifies. HDF5's own checksums find damage in an array that is read.

    Args:
        sha256: canonical hash (hex) of the recording that was verified; empty: whichever is stored there.

    Raises RecordingError as ``read_header`` does, for a file with another hash, and for a damaged array where it is
    used.
    """
    path = Path(path)
    with ExitStack() as held:
        file = held.enter_context(opened(path))
        found = find_datasets(path, file)
        check_sizes(path, found)
        stored = read_bytes(path, found, CHECKSUM).hex()
        if sha256 not in ("", stored):
            raise RecordingError(f"{path}: sha256 {stored[:12]} and not {sha256[:12]}, as when it was scored")
        header = _header_in(path, read_bytes(path, found, HEADER))
        check_header(header, str(path))
        return Recording.trusted(header, _Stored(path, _arrays_in(found), held.pop_all()), sha256=stored)


class _Stored(Mapping[str, npt.NDArray[Any]]):
    """The arrays of a file that stays open, each read once it is used."""

    def __init__(self, path: Path, items: Mapping[str, Any], held: ExitStack) -> None:
        self._path, self._items, self._held = path, items, held
        self._loaded: dict[str, npt.NDArray[Any]] = {}

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        if name not in self._loaded:
            self._loaded[name] = load(self._path, name, self._items[name])
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self._items

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)


def read_header(path: Path | str) -> Header:
    """Read the header of a trial file without its arrays, in a fraction of the time that ``read_recording`` takes.

    Verifies that the file has the length that it was written with, that header and stored checksum pass HDF5's own
    checksums, and that the header says nothing that no trial can say. A flipped bit in an array stays unseen, and so
    does a missing array: only ``read_recording`` finds those.

    Raises RecordingError as ``read_recording`` does, for what is verified.
    """
    path = Path(path)
    with opened(path) as file:
        found = root_datasets(path, file)
        read_bytes(path, found, CHECKSUM)
        header = _header_in(path, read_bytes(path, found, HEADER))
    check_header(header, str(path))
    return header


def stored_sha256(path: Path | str) -> str:
    """Return the canonical hash (hex) that a trial file says it has; only ``read_recording`` computes it again."""
    path = Path(path)
    with opened(path) as file:
        return read_bytes(path, root_datasets(path, file), CHECKSUM).hex()


def _arrays_in(found: Mapping[str, Any]) -> dict[str, Any]:
    return {name: item for name, item in sorted(found.items()) if name not in (CHECKSUM, HEADER)}


def _header_in(path: Path, content: bytes) -> Header:
    """Parse the header of a file. Raises RecordingError for what is not JSON, another schema, and a wrong field."""
    try:
        parsed = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: {HEADER} is not JSON: {ascii(str(error))[1:-1]}") from None
    data = cast("dict[str, Any]", parsed) if isinstance(parsed, dict) else {}
    check_version(data.get("schema_version"), str(path))
    try:
        return Header.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        versions = data.get("versions")
        absent = missing_suppliers(cast("dict[str, str]", versions)) if isinstance(versions, dict) else []
        also = f"; it was recorded with {', '.join(absent)}, not installed here" if absent else ""
        raise RecordingError(
            f"{path}: header field {place}: {first['msg']} ({error.error_count()} wrong){also}"
        ) from None
