"""A trial is a file: schema, writer, reader and canonical hash, without a simulator."""

from carecontact.recording.canonical import canonical_hash
from carecontact.recording.reader import open_recording, read_header, read_recording, stored_sha256
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
from carecontact.recording.writer import write_recording

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
