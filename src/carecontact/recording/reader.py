"""Read a trial file, or say what is wrong with it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from carecontact.errors import RecordingError
from carecontact.recording.canonical import canonical_digest
from carecontact.recording.check import check_header, check_recording
from carecontact.recording.migration import RawRecording, check_version, migrate
from carecontact.recording.schema import SCHEMA_VERSION, Header, Recording
from carecontact.recording.stored_file import (
    check_sizes,
    check_structure,
    find_datasets,
    load,
    opened,
    read_bytes,
    root_datasets,
)
from carecontact.recording.versions import missing_suppliers
from carecontact.recording.writer import CHECKSUM, HEADER


@dataclass(frozen=True, kw_only=True)
class VerifiedRecording:
    recording: Recording
    """The recording in this release's schema."""
    sha256: str
    """Stored in the file and found again: the canonical hash of the recording as it was written (hex)."""


def read_recording(path: Path | str) -> Recording:
    """Read and verify one trial file; an earlier schema is migrated.

    Raises RecordingError naming the file and the fault: absent, not HDF5, truncated, damaged, foreign, too large,
    a schema that no migration starts from, a required array missing or of the wrong dtype or shape, or a checksum that
    differs. Raises ConfigError for an installed action or region that its protocol names and that cannot be loaded.
    """
    return read_verified(path).recording


def read_verified(path: Path | str) -> VerifiedRecording:
    """Read and verify as ``read_recording`` does, and return the checksum too."""
    path = Path(path)
    with opened(path) as file:
        return _read(path, file)


def read_header(path: Path | str) -> Header:
    """Read the header of a trial file without its arrays, in a fraction of the time that ``read_recording`` takes.

    Verifies that the file has the length that it was written with, that header and stored checksum pass HDF5's own
    checksums, and that the header says nothing that no trial can say. A flipped bit in an array stays unseen, and so
    does a missing array: only ``read_recording`` finds those. A recording of an earlier schema is read whole if its
    migration needs the arrays.

    Raises RecordingError as ``read_recording`` does, for what is verified.
    """
    path = Path(path)
    with opened(path) as file:
        found = root_datasets(path, file)
        read_bytes(path, found, CHECKSUM)
        data = _parse_json(path, read_bytes(path, found, HEADER))
    if check_version(data.get("schema_version"), str(path)) != SCHEMA_VERSION:
        try:
            data = migrate(RawRecording(header=data, arrays={}), str(path)).header
        except RecordingError:
            return read_recording(path).header
    header = _parse_header(path, data)
    check_header(header, str(path))
    return header


def stored_sha256(path: Path | str) -> str:
    """Return the canonical hash (hex) that a trial file says it has; nothing but ``read_verified`` computes it again.

    Verifies the file's length and the stored hash itself. Raises RecordingError where that cannot be read.
    """
    path = Path(path)
    with opened(path) as file:
        return read_bytes(path, root_datasets(path, file), CHECKSUM).hex()


def _read(path: Path, file: Any) -> VerifiedRecording:
    found = find_datasets(path, file)
    check_sizes(path, found)
    check_structure(path, found)
    stored, content = read_bytes(path, found, CHECKSUM), read_bytes(path, found, HEADER)
    data = _parse_json(path, content)
    arrays = {name: item for name, item in sorted(found.items()) if name not in (CHECKSUM, HEADER)}
    current = check_version(data.get("schema_version"), str(path)) == SCHEMA_VERSION
    header = _parse_header(path, data) if current else None
    if header is not None:
        # As declared, before anything is unpacked: arrays that contradict each other cost no memory.
        check_recording(Recording(header=header, arrays=arrays), str(path))
    loaded = {name: load(path, name, item) for name, item in arrays.items()}

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
        versions = data.get("versions")
        absent = missing_suppliers(cast("dict[str, str]", versions)) if isinstance(versions, dict) else []
        also = f"; it was recorded with {', '.join(absent)}, not installed here" if absent else ""
        raise RecordingError(
            f"{path}: header field {place}: {first['msg']} ({error.error_count()} wrong){also}"
        ) from None
