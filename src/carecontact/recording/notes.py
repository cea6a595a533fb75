"""Arrays that a recording may hold besides the trial: the policy's notes at its steps, which no metric uses, and the
error of its perception against the simulator's truth, for the scorer alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.interface.policy import CAMERAS
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
    entries: list[Any] = [note.content.get("language") for note in read_notes(recording)]
    logs = [cast("list[Any]", entry) for entry in entries if isinstance(entry, list)]
    calls = [cast("dict[str, Any]", call) for log in logs for call in log if isinstance(call, dict)]
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


JOINTS = {
    f"{side} {joint}": 11 + 2 * row + column
    for row, joint in enumerate(("shoulder", "elbow", "wrist", "", "", "", "hip", "knee", "ankle"))
    if joint
    for column, side in enumerate(("left", "right"))
}
"""Joints whose centres the simulator knows -> index in MediaPipe Pose's order."""

ARRAYS: dict[str, tuple[str, tuple[int | Literal["R"], ...], str]] = {
    "perception/observation_index": ("i4", (), "which observation"),
    "perception/camera_index": ("i4", (), "of interface.policy.CAMERAS"),
    "perception/joint_visible": ("b1", (len(JOINTS),), "in the image, and nothing but its own limb before it"),
    "perception/landmark_error_px": ("f4", (len(JOINTS),), "[px] to the joint centre; NaN: hidden or no person found"),
    "perception/human_iou": ("f4", (), "of the human mask with the true one; NaN: the policy did not request masks"),
    "perception/target_error_m": (
        "f4",
        ("R", 3),
        "[m] from the true place to the one that the state machine finds: along and across the limb's shadow on the "
        "floor, up; NaN: not found, or not requested",
    ),
}
"""Path -> dtype, shape after N with R for the number of the header's regions, meaning. N rows, one for each camera and
observation in which the policy requested landmarks or masks."""


@dataclass(frozen=True, kw_only=True)
class PerceptionErrors:
    observation_index: npt.NDArray[np.int32]
    camera: list[str]
    joint_visible: npt.NDArray[np.bool_]
    landmark_error_px: npt.NDArray[np.float32]
    human_iou: npt.NDArray[np.float32]
    target_error_m: npt.NDArray[np.float32]


def perception_errors(recording: Recording) -> PerceptionErrors | None:
    """Return the errors of perception; None where no perception was requested.

    Raises RecordingError naming an array that is missing or has another dtype or shape.
    """
    if not any(path in recording.arrays for path in ARRAYS):
        return None
    got: dict[str, npt.NDArray[Any]] = {}
    rows: int | None = None
    for path, (dtype, after, _) in ARRAYS.items():
        array = recording.arrays.get(path)
        if array is None:
            raise RecordingError(f"{path} is missing though other arrays of its group are there")
        rows = len(array) if rows is None and array.ndim else rows
        shape = (rows, *(len(recording.header.regions) if size == "R" else size for size in after))
        if array.dtype.newbyteorder("<") != np.dtype(dtype).newbyteorder("<") or array.shape != shape:
            raise RecordingError(f"{path} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}")
        got[path.partition("/")[2]] = array
    index = got.pop("camera_index")
    if ((index < 0) | (index >= len(CAMERAS))).any():
        raise RecordingError(f"perception/camera_index: expected 0 to {len(CAMERAS) - 1}")
    return PerceptionErrors(camera=[CAMERAS[i] for i in index], **got)
