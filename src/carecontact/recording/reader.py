"""Read a trial file, or say what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from carecontact.errors import RecordingError
from carecontact.recording.canonical import canonical_digest
from carecontact.recording.check import STORABLE_KINDS, check_recording
from carecontact.recording.migration import RawRecording, check_version, migrate
from carecontact.recording.schema import SCHEMA_VERSION, Header, Recording
from carecontact.recording.writer import CHECKSUM, HEADER

MAX_FILE_BYTES = 4 << 30
MAX_ARRAY_BYTES = 4 << 30
"""Of all arrays together, as declared and before any is unpacked: a few hundred bytes can claim terabytes."""
MAX_EXPANSION = 1100
"""Declared over stored bytes of one array; deflate reaches at most 1032."""
FREE_BYTES = 1 << 16
"""An array this small may have any expansion."""
MAX_CHUNK_BYTES = 256 << 20
MAX_HEADER_BYTES = 16 << 20
MAX_ARRAYS = 100_000


@dataclass(frozen=True, kw_only=True)
class VerifiedRecording:
    recording: Recording
    """In this release's schema."""
    sha256: str
    """Stored in the file and found again: the canonical hash of the recording as it was written (hex)."""


def read_recording(path: Path | str) -> Recording:
    """Read and verify one trial file; an earlier schema is migrated.

    Raises RecordingError naming the file and the fault: absent, not HDF5, truncated, damaged, foreign, too large,
    a schema that no migration starts from, a required array missing or of the wrong dtype or shape, or a checksum that
    differs.
    """
    return read_verified(path).recording


def read_verified(path: Path | str) -> VerifiedRecording:
    """As ``read_recording``, with the checksum that the file was verified by."""
    path = Path(path)
    try:
        if not path.is_file():
            raise RecordingError(f"{path}: no such file")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise RecordingError(
                f"{path}: {path.stat().st_size} bytes, more than the {MAX_FILE_BYTES} a trial may have"
            )
        return _read(path)
    except RecordingError:
        raise
    except Exception as error:  # h5py answers damage with OSError, KeyError, RuntimeError, ValueError, TypeError ...
        message = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable HDF5 file, truncated or damaged: {message}") from None


def _read(path: Path) -> VerifiedRecording:
    h5py: Any = import_module("h5py")  # ships no types
    with h5py.File(path, "r") as file:
        found = _find_datasets(path, file)
        _check_sizes(path, found)
        stored, content = _read_bytes(path, found, CHECKSUM), _read_bytes(path, found, HEADER)
        data = _parse_json(path, content)
        arrays = {name: item for name, item in sorted(found.items()) if name not in (CHECKSUM, HEADER)}
        current = check_version(data.get("schema_version"), str(path)) == SCHEMA_VERSION
        header = _parse_header(path, data) if current else None
        if header is not None:
            # As declared, before anything is unpacked: arrays that contradict each other cost no memory.
            check_recording(Recording(header=header, arrays=arrays), str(path))
        loaded = {name: _load(path, name, item) for name, item in arrays.items()}

    # Over the bytes that were written: a header that this release would spell differently is still the same.
    actual = canonical_digest(content, loaded)
    if actual != stored.hex():
        raise RecordingError(
            f"{path}: checksum {actual[:12]}... differs from the stored {stored.hex()[:12]}...: damaged"
        )
    if header is None:
        raw = migrate(RawRecording(header=data, arrays=loaded), str(path))
        header, loaded = _parse_header(path, raw.header), raw.arrays
    recording = Recording(header=header, arrays=loaded)
    check_recording(recording, str(path))
    return VerifiedRecording(recording=recording, sha256=actual)


def _find_datasets(path: Path, file: Any) -> dict[str, Any]:
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


def _check_sizes(path: Path, found: Mapping[str, Any]) -> None:
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


def _read_bytes(path: Path, found: Mapping[str, Any], name: str) -> bytes:
    absent = [n for n in (HEADER, CHECKSUM) if n not in found]
    if absent:
        raise RecordingError(f"{path}: HDF5 but no carecontact recording: {' and '.join(absent)} missing")
    item = found[name]
    if item.dtype != np.uint8 or item.ndim != 1:
        raise RecordingError(f"{path}: {name} is {item.dtype} of shape {item.shape}, expected a row of bytes (uint8)")
    return _load(path, name, item).tobytes()


def _load(path: Path, name: str, item: Any) -> npt.NDArray[Any]:
    try:
        return np.asarray(item[()])
    except OSError as error:  # of a checksum or a decompression that fails
        raise RecordingError(f"{path}: {name} is truncated or damaged: {' '.join(str(error).split())}") from None


def _parse_json(path: Path, content: bytes) -> dict[str, Any]:
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: {HEADER} is not JSON: {ascii(str(error))[1:-1]}") from None
    return cast("dict[str, Any]", data) if isinstance(data, dict) else {}


def _parse_header(path: Path, data: dict[str, Any]) -> Header:
    try:
        return Header.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise RecordingError(f"{path}: header field {place}: {first['msg']} ({error.error_count()} wrong)") from None
