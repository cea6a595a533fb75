"""A trial is a file: schema, writer, reader and canonical hash, without a simulator."""

from carecontact.recording.canonical import canonical_hash
from carecontact.recording.check import check_recording
from carecontact.recording.migration import MIGRATIONS, RawRecording
from carecontact.recording.reader import VerifiedRecording, read_header, read_recording, read_verified, stored_sha256
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
    "MIGRATIONS",
    "OPTIONAL_ARRAYS",
    "SCHEMA_VERSION",
    "SEGMENTS",
    "EndReason",
    "Failure",
    "Header",
    "RawRecording",
    "Recording",
    "VerifiedRecording",
    "canonical_hash",
    "check_recording",
    "empty_arrays",
    "read_header",
    "read_recording",
    "read_verified",
    "stored_sha256",
    "write_recording",
]
