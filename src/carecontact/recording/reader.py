"""Read a trial file, or say what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy.typing as npt
from pydantic import ValidationError

from carecontact.errors import RecordingError
from carecontact.recording.canonical import canonical_digest
from carecontact.recording.schema import Header, Recording, check_header, check_recording, check_version
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
    """Return the canonical hash (hex) that a trial file says it has; only ``read_recording`` computes it again.

    Verifies the file's length and the stored hash itself. Raises RecordingError where that cannot be read.
    """
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
