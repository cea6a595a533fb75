"""Checks whether a recording is well formed: before it is written, after it is read, and before it is scored."""

from __future__ import annotations

import re
from math import isfinite

import numpy as np

from carecontact.contract.policy import CAMERAS
from carecontact.errors import RecordingError
from carecontact.recording.canonical import WALL_CLOCK
from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, SCHEMA_VERSION, Header, Recording, dimensions
from carecontact.regions import REGIONS

PATH = re.compile(r"(policy|scorer|actions|state|report|perception|wall)(/[A-Za-z0-9_.-]+)+")
STORABLE_KINDS = "biuf"
MAX_WALL_BYTES = 1 << 20
"""Largest size of all arrays together that no hash covers; the longest is what a policy printed last, 8 kB."""


def check_recording(recording: Recording, place: str) -> Recording:
    """Returns the recording; ``place`` begins the message.

    Raises RecordingError naming the array and what was expected: schema version, presence, dtype and the shapes of
    ARRAYS and OPTIONAL_ARRAYS, whose named dimensions must agree with one another and with the header's lists.
    """
    header = recording.header
    check_header(header, place)
    missing = sorted(ARRAYS.keys() - recording.arrays.keys())
    if missing:
        raise RecordingError(f"{place}: missing from its required arrays: {', '.join(missing)}")
    for path, array in recording.arrays.items():
        if not PATH.fullmatch(path) or ".." in path:
            raise RecordingError(f"{place}: unexpected array path {path!r}")
        if array.dtype.kind not in STORABLE_KINDS:
            raise RecordingError(f"{place}: {path} has dtype {array.dtype}; only numbers and booleans are stored")

    unhashed = sum(array.nbytes for path, array in recording.arrays.items() if path.startswith(WALL_CLOCK))
    if unhashed > MAX_WALL_BYTES:
        allowed = f"at most {MAX_WALL_BYTES} are allowed there"
        raise RecordingError(f"{place}: {WALL_CLOCK} has {unhashed} bytes, which no checksum covers; {allowed}")
    sizes = {
        "S": (len(header.segments), "header.segments"),
        "R": (len(header.regions), "header.regions"),
        "J": (len(header.human_joints), "header.human_joints"),
        "V": (len(CAMERAS), "contract.policy.CAMERAS"),
    }
    described = ARRAYS | {path: row for path, row in OPTIONAL_ARRAYS.items() if path in recording.arrays}
    for path, (dtype, _) in described.items():
        array, dims = recording.arrays[path], dimensions(path)
        if array.dtype.newbyteorder("<") != np.dtype(dtype).newbyteorder("<"):
            raise RecordingError(f"{place}: {path} has dtype {array.dtype}, expected {np.dtype(dtype)}")
        if array.ndim != len(dims):
            raise RecordingError(f"{place}: {path} has shape {array.shape}, expected ({', '.join(dims)})")
        for name, size in zip(dims, array.shape, strict=True):
            expected, source = (int(name), "the schema") if name.isdigit() else sizes.setdefault(name, (size, path))
            if size != expected:
                raise RecordingError(
                    f"{place}: {path} has shape {array.shape}, expected ({', '.join(dims)}) "
                    f"with {name} = {expected} as in {source}"
                )
    return recording


def check_header(header: Header, place: str) -> None:
    """Raises RecordingError, which begins with ``place``, for a header that no trial of this schema can have."""
    if header.schema_version != SCHEMA_VERSION:
        raise RecordingError(f"{place}: schema {header.schema_version!r}; this release reads {SCHEMA_VERSION!r}")
    if header.spec.task_id not in {t.id for t in header.spec.protocol.tasks}:
        raise RecordingError(f"{place}: task {header.spec.task_id!r} is not in protocol {header.spec.protocol.id!r}")
    _check_names(header, place)
    if len(header.pose_base_in_world) != 7:
        raise RecordingError(f"{place}: pose_base_in_world has {len(header.pose_base_in_world)} numbers, expected 7")
    if not all(isfinite(number) for number in header.pose_base_in_world):
        raise RecordingError(f"{place}: pose_base_in_world holds {header.pose_base_in_world}; expected finite numbers")


def _check_names(header: Header, place: str) -> None:
    """Columns are found by their names: each name occurs once, and every name that the task's score needs is there."""
    protocol = header.spec.protocol
    region = protocol.task(header.spec.task_id).region
    needed = {
        "segments": [REGIONS[region].segment, *protocol.contact.neighbourhood[region]],
        "regions": [region],
        "human_joints": list[str](),
    }
    for name, wanted in needed.items():
        listed: list[str] = getattr(header, name)
        if len(set(listed)) != len(listed):
            raise RecordingError(f"{place}: header.{name} names something twice: {', '.join(listed)}")
        absent = [w for w in wanted if w not in listed]
        if absent:
            raise RecordingError(f"{place}: {absent[0]!r} is not in header.{name}; listed: {', '.join(listed)}")
