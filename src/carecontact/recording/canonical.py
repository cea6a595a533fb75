"""The identity of a recording: what a hash covers and in which spelling."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.recording.schema import WALL_CLOCK, Header, Recording


def header_json(header: Header) -> bytes:
    """Return one spelling of a header: sorted keys, no white space, ASCII."""
    return json.dumps(header.model_dump(mode="json"), sort_keys=True, separators=(",", ":")).encode("ascii")


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
