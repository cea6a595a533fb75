"""A policy's notes at its steps, which no metric uses, and the errors of its perception, for the scorer alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.interface.policy import CAMERAS
from carecontact.recording.schema import OPTIONAL_ARRAYS, Recording

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
    entries: list[Any] = [note.content.get("language") for note in read_notes(recording)]
    logs = [cast("list[Any]", entry) for entry in entries if isinstance(entry, list)]
    calls = [cast("dict[str, Any]", call) for log in logs for call in log if isinstance(call, dict)]
    pairs = [[call.get("request_sha256"), call.get("completion_sha256")] for call in calls]
    live = [call for call in calls if "endpoint" in call]
    return LanguageUse(
        sha256=hashlib.sha256(json.dumps(pairs).encode()).hexdigest() if pairs else None,
        endpoint=_joined(call["endpoint"] for call in live),
        served=_joined(call.get("model") for call in live),
        sent=_joined(
            " ".join(sorted(f"{k}={v}" for k, v in cast("dict[Any, Any]", sent).items()))
            for call in live
            if isinstance(sent := call.get("sent"), dict)
        ),
    )


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


JOINTS = {
    f"{side} {joint}": 11 + 2 * row + column
    for row, joint in enumerate(("shoulder", "elbow", "wrist", "", "", "", "hip", "knee", "ankle"))
    if joint
    for column, side in enumerate(("left", "right"))
}
"""Joints whose centres the simulator knows -> index in MediaPipe Pose's order."""

PERCEPTION = tuple(path for path in OPTIONAL_ARRAYS if path.startswith("perception/"))


@dataclass(frozen=True, kw_only=True)
class PerceptionErrors:
    observation_index: npt.NDArray[np.int32]
    camera: list[str]
    joint_visible: npt.NDArray[np.bool_]
    landmark_error_px: npt.NDArray[np.float32]
    human_iou: npt.NDArray[np.float32]
    target_error_m: npt.NDArray[np.float32]


def perception_errors(recording: Recording) -> PerceptionErrors | None:
    """Return the errors of perception, None where none was requested. Raises RecordingError for malformed arrays."""
    absent = [path for path in PERCEPTION if path not in recording]
    if len(absent) == len(PERCEPTION):
        return None
    if absent:
        raise RecordingError(f"{absent[0]} is missing though other arrays of its group are there")
    got: dict[str, Any] = {path.partition("/")[2]: recording[path] for path in PERCEPTION}
    index = got.pop("camera_index")
    if ((index < 0) | (index >= len(CAMERAS))).any():
        raise RecordingError(f"perception/camera_index: expected 0 to {len(CAMERAS) - 1}")
    return PerceptionErrors(camera=[CAMERAS[i] for i in index], **got)
