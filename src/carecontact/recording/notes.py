"""What a policy wanted to be kept of its steps: for people to look at, and for provenance; into no score."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording

PREFIX = "policy/notes/"


@dataclass(frozen=True, kw_only=True)
class Note:
    observation_index: int
    content: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]] = field(default_factory=dict[str, npt.NDArray[Any]])


def read_notes(recording: Recording) -> list[Note]:
    """In the order of the steps. Raises RecordingError for notes that are no JSON."""
    grouped: dict[str, dict[str, npt.NDArray[Any]]] = {}
    for path, array in recording.arrays.items():
        if path.startswith(PREFIX):
            index, _, name = path.removeprefix(PREFIX).partition("/")
            grouped.setdefault(index, {})[name] = array
    return [_note(recording, index, arrays) for index, arrays in sorted(grouped.items())]


def language_sha256(recording: Recording) -> str | None:
    """Hash (hex) over the requests and completions of all language calls, in order; None if there was none."""
    pairs: list[list[object]] = []
    for note in read_notes(recording):
        calls = note.content.get("language", [])
        for call in cast("list[Any]", calls) if isinstance(calls, list) else []:
            if isinstance(call, dict):
                entry = cast("dict[str, Any]", call)
                pairs.append([entry.get("request_sha256"), entry.get("completion_sha256")])
    return hashlib.sha256(json.dumps(pairs).encode()).hexdigest() if pairs else None


def _note(recording: Recording, index: str, arrays: dict[str, npt.NDArray[Any]]) -> Note:
    place = f"{recording.header.spec.trial_id}: {PREFIX}{index}"
    try:
        content = json.loads(arrays["json"].astype(np.uint8).tobytes())
        number = int(index)
    except (KeyError, ValueError, RecursionError) as error:
        raise RecordingError(f"{place} is no note: {error}") from None
    if not isinstance(content, dict):
        raise RecordingError(f"{place}/json is no map")
    rest = {name: array for name, array in arrays.items() if name != "json"}
    return Note(observation_index=number, content=cast("dict[str, Any]", content), arrays=rest)
