"""A trial as a file: schema, writer, one verified read, canonical hash, and export; without a simulator."""

from carecontact.recording.file import (
    canonical_hash,
    open_recording,
    read_header,
    read_recording,
    stored_sha256,
    write_recording,
)
from carecontact.recording.schema import (
    ARRAYS,
    OPTIONAL_ARRAYS,
    SCHEMA_VERSION,
    SEGMENTS,
    EndReason,
    Failure,
    Header,
    Recording,
    empty_arrays,
)

__all__ = [
    "ARRAYS",
    "OPTIONAL_ARRAYS",
    "SCHEMA_VERSION",
    "SEGMENTS",
    "EndReason",
    "Failure",
    "Header",
    "Recording",
    "canonical_hash",
    "empty_arrays",
    "open_recording",
    "read_header",
    "read_recording",
    "stored_sha256",
    "write_recording",
]
