"""Migration of recordings: each function converts a recording of an earlier schema into the next one.

To change the schema: raise SCHEMA_VERSION and add to MIGRATIONS the function that converts the version before it. Files
stay as they are; the reader converts what it has read, after the checksum of the file as it was written has been
verified.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording.schema import SCHEMA_VERSION


@dataclass(frozen=True, kw_only=True)
class RawRecording:
    """A recording whose header has been parsed as JSON, but not validated yet."""

    header: dict[str, Any]
    """Parsed JSON; ``schema_version`` says what the rest means."""
    arrays: dict[str, npt.NDArray[Any]]


Migration = Callable[[RawRecording], RawRecording]


def from_1(raw: RawRecording) -> RawRecording:
    """Version 2 names the controller; every trial of version 1 had the Cartesian impedance. It renamed no array."""
    control = None if raw.header.get("card") is None else "cartesian-impedance"
    return RawRecording(
        header={**raw.header, "schema_version": "carecontact-recording-2", "control": control}, arrays=raw.arrays
    )


def from_2(raw: RawRecording) -> RawRecording:
    """Version 3 has the compiled tissue: rows of tissue lost what described the coarser meshes of other regions, and
    got a contact layer, which is None in an earlier row. No array changed; those of cells are new.

    ``sha256.protocol`` becomes the hash of the rules as they were written, so that the trial can still be told from
    and compared with others of its protocol.
    """
    header, spec = raw.header, raw.header["spec"]
    protocol = spec["protocol"]
    rows, new = protocol["person"]["tissue"], "carecontact-recording-3"
    if all("contact_n_m3" in row for row in rows.values()):
        return RawRecording(header={**header, "schema_version": new}, arrays=raw.arrays)
    written = {name: value for name, value in protocol.items() if name != "overrides" or value}
    digest = hashlib.sha256(json.dumps(written, sort_keys=True).encode()).hexdigest()
    tissue = {
        region: {name: value for name, value in row.items() if name not in COARSE_MESHES} | {"contact_n_m3": None}
        for region, row in rows.items()
    }
    lifted = {**protocol, "person": {**protocol["person"], "tissue": tissue}}
    return RawRecording(
        header={
            **header, "schema_version": new, "spec": {**spec, "protocol": lifted},
            "sha256": {**header["sha256"], "protocol": digest},
        },
        arrays=raw.arrays,
    )  # fmt: skip


COARSE_MESHES = ("off_target_spacing_m", "off_target_scale")
"""Fields of a row of tissue until version 2."""
MIGRATIONS: dict[str, Migration] = {"carecontact-recording-1": from_1, "carecontact-recording-2": from_2}
"""Schema version -> pure function that returns the recording in a later version. Version 1 is the first."""


def check_version(version: object, place: str) -> str:
    """Returns the version. Raises RecordingError unless it is this release's or one that a migration starts from."""
    readable = (SCHEMA_VERSION, *sorted(MIGRATIONS))
    if not isinstance(version, str) or version not in readable:
        raise RecordingError(f"{place}: schema {version!r}; this release reads {', '.join(map(repr, readable))}")
    return version


def migrate(raw: RawRecording, place: str) -> RawRecording:
    """Convert step by step to SCHEMA_VERSION. Raises RecordingError naming ``place`` and the step that failed."""
    passed: list[str] = []
    while (version := check_version(raw.header.get("schema_version"), place)) != SCHEMA_VERSION:
        if version in passed:
            raise RecordingError(f"{place}: migrations go in a circle: {' -> '.join([*passed, version])}")
        passed.append(version)
        try:
            raw = MIGRATIONS[version](raw)
        except Exception as error:  # whatever a malformed old header or array makes it stumble over
            what = " ".join(f"{type(error).__name__}: {error}".split())
            raise RecordingError(f"{place}: cannot be migrated from schema {version!r}: {what}") from error
    return raw
