"""The notes that a policy made at its steps. They serve inspection and provenance, and no metric uses them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording

PREFIX = "policy/notes/"
MAX_JOINED_CHARS = 500


@dataclass(frozen=True, kw_only=True)
class Note:
    observation_index: int
    content: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]] = field(default_factory=dict[str, npt.NDArray[Any]])


def read_notes(recording: Recording) -> list[Note]:
    """Return a policy's notes in the order of the steps. Raises RecordingError for notes that are no JSON."""
    grouped: dict[str, dict[str, npt.NDArray[Any]]] = {}
    for path, array in recording.arrays.items():
        if path.startswith(PREFIX):
            index, _, name = path.removeprefix(PREFIX).partition("/")
            grouped.setdefault(index, {})[name] = array
    return [_note(recording, index, arrays) for index, arrays in sorted(grouped.items())]


@dataclass(frozen=True, kw_only=True)
class LanguageUse:
    """What language models were asked and answered in one trial, as its policy noted it."""

    sha256: str | None = None
    """Hash (hex) over the requests and completions of all calls, in order; None if there was none."""
    endpoint: str | None = None
    """Hosts that were asked, distinct and joined by commas, as the two below; None where none is noted."""
    served: str | None = None
    """Models that those hosts say they answered with."""
    sent: str | None = None
    """Sampling parameters that they accepted."""


def language_use(recording: Recording) -> LanguageUse:
    """Return what the notes say about the use of language models. Raises RecordingError for notes that are no JSON."""
    calls: list[dict[str, Any]] = []
    for note in read_notes(recording):
        entries = note.content.get("language", [])
        for call in cast("list[Any]", entries) if isinstance(entries, list) else []:
            calls += [cast("dict[str, Any]", call)] if isinstance(call, dict) else []
    pairs = [[call.get("request_sha256"), call.get("completion_sha256")] for call in calls]
    live = [call for call in calls if "endpoint" in call]
    return LanguageUse(
        sha256=hashlib.sha256(json.dumps(pairs).encode()).hexdigest() if pairs else None,
        endpoint=_joined(call["endpoint"] for call in live),
        served=_joined(call.get("model") for call in live),
        sent=_joined(_parameters(call.get("sent")) for call in live),
    )


def _parameters(sent: object) -> str | None:
    if not isinstance(sent, dict):
        return None
    return " ".join(sorted(f"{k}={v}" for k, v in cast("dict[Any, Any]", sent).items()))


def _joined(values: Iterable[object]) -> str | None:
    """A policy can note anything: text alone, in what a table can hold."""
    texts = sorted({v for v in values if isinstance(v, str) and v.isprintable()})
    return ", ".join(texts)[:MAX_JOINED_CHARS] or None


def _note(recording: Recording, index: str, arrays: dict[str, npt.NDArray[Any]]) -> Note:
    place = f"{recording.header.spec.trial_id}: {PREFIX}{index}"
    try:
        content = json.loads(arrays["json"].astype(np.uint8).tobytes())
        number = int(index)
    except (KeyError, ValueError, RecursionError) as error:
        raise RecordingError(f"{place} is not a note: {error}") from None
    if not isinstance(content, dict):
        raise RecordingError(f"{place}/json is not a map")
    rest = {name: array for name, array in arrays.items() if name != "json"}
    return Note(observation_index=number, content=cast("dict[str, Any]", content), arrays=rest)
