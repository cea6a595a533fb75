"""Read a trial file, or say what is wrong with it."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from carecontact.errors import RecordingError
from carecontact.recording.canonical import canonical_hash
from carecontact.recording.check import STORABLE_KINDS, check_recording
from carecontact.recording.schema import SCHEMA_VERSION, Header, Recording
from carecontact.recording.writer import CHECKSUM, HEADER

MAX_FILE_BYTES = 4 << 30
MAX_ARRAY_BYTES = 8 << 30
"""Of all arrays together, as declared and before any is unpacked: a few hundred bytes of gzip can claim terabytes."""
MAX_HEADER_BYTES = 16 << 20
MAX_ARRAYS = 100_000


def read_recording(path: Path | str) -> Recording:
    """Read and verify one trial file.

    Raises RecordingError naming the file and the fault: absent, not HDF5, truncated, damaged, foreign, too large,
    another schema version, a required array missing or of the wrong dtype or shape, or a checksum that differs.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise RecordingError(f"{path}: {path.stat().st_size} bytes, more than the {MAX_FILE_BYTES} a trial may have")
    try:
        raw = _read_datasets(path)
    except RecordingError:
        raise
    except Exception as error:  # h5py answers damage with OSError, KeyError, RuntimeError, ValueError, TypeError ...
        message = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable HDF5 file, truncated or damaged: {message}") from None

    absent = [name for name in (HEADER, CHECKSUM) if name not in raw]
    if absent:
        raise RecordingError(f"{path}: HDF5 but no carecontact recording: {' and '.join(absent)} missing")
    stored = raw.pop(CHECKSUM).tobytes().hex()
    recording = Recording(header=_parse_header(path, raw.pop(HEADER).tobytes()), arrays=raw)
    check_recording(recording, str(path))
    actual = canonical_hash(recording)
    if actual != stored:
        raise RecordingError(f"{path}: checksum {actual[:12]}... differs from the stored {stored[:12]}...: damaged")
    return recording


def _read_datasets(path: Path) -> dict[str, npt.NDArray[Any]]:
    h5py: Any = import_module("h5py")  # ships no types
    with h5py.File(path, "r") as file:
        found: dict[str, Any] = {}
        folders: list[tuple[str, Any]] = [("", file)]
        while folders:
            prefix, group = folders.pop()
            if len(found) + len(folders) > MAX_ARRAYS or prefix.count("/") > 8:
                raise RecordingError(f"{path}: more than {MAX_ARRAYS} arrays or nested deeper than 8 groups")
            for name in list[str](group):
                if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                    raise RecordingError(f"{path}: {prefix}{name} is a link; a recording is one self-contained file")
                item = group[name]
                if isinstance(item, h5py.Group):
                    folders.append((f"{prefix}{name}/", item))
                elif isinstance(item, h5py.Dataset):
                    found[prefix + name] = item
                else:
                    raise RecordingError(f"{path}: {prefix}{name} is neither a group nor an array")

        total = 0
        for name, item in found.items():
            if item.is_virtual or item.external:
                raise RecordingError(f"{path}: {name} is stored in another file; a recording is self-contained")
            if item.shape is None or item.dtype.kind not in STORABLE_KINDS:
                raise RecordingError(f"{path}: {name} has dtype {item.dtype}; only numbers and booleans are allowed")
            size = int(np.prod(item.shape, dtype=object)) * item.dtype.itemsize
            total += size
            if total > MAX_ARRAY_BYTES or (name == HEADER and size > MAX_HEADER_BYTES):
                raise RecordingError(f"{path}: {name} declares {size} bytes, more than a trial may have")
        return {name: np.asarray(item[()]) for name, item in sorted(found.items())}


def _parse_header(path: Path, content: bytes) -> Header:
    try:
        data = json.loads(content)
    except ValueError as error:
        raise RecordingError(f"{path}: {HEADER} is not JSON: {error}") from None
    version = cast("dict[str, Any]", data).get("schema_version") if isinstance(data, dict) else None
    if version != SCHEMA_VERSION:
        raise RecordingError(f"{path}: schema {version!r}; this release reads {SCHEMA_VERSION!r}")
    try:
        return Header.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise RecordingError(f"{path}: header field {place}: {first['msg']} ({error.error_count()} wrong)") from None
