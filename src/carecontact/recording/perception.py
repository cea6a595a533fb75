"""The error of perception against the simulator's truth in a trial: optional arrays of a recording, for the scorer
only.

N rows, one per camera and observation in which the policy requested landmarks or masks; R regions as in the schema.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from carecontact.contract.policy import CAMERAS
from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording

JOINTS = {
    f"{side} {joint}": 11 + 2 * row + column
    for row, joint in enumerate(("shoulder", "elbow", "wrist", "", "", "", "hip", "knee", "ankle"))
    if joint
    for column, side in enumerate(("left", "right"))
}
"""Joints whose centres the simulator knows -> index in MediaPipe Pose's order."""

ARRAYS: dict[str, tuple[str, tuple[int | Literal["R"], ...], str]] = {
    "perception/observation_index": ("i4", (), "which observation"),
    "perception/camera_index": ("i4", (), "of contract.policy.CAMERAS"),
    "perception/joint_visible": ("b1", (len(JOINTS),), "in the image, and nothing but its own limb before it"),
    "perception/landmark_error_px": ("f4", (len(JOINTS),), "[px] to the joint centre; NaN: hidden or nobody found"),
    "perception/human_iou": ("f4", (), "of the human mask with the true one; NaN: the policy did not request masks"),
    "perception/target_error_m": (
        "f4", ("R", 3),
        "[m] from the true place to the one that the state machine finds: along and across the limb's shadow on the "
        "floor, up; NaN: not found, or not requested",
    ),
}  # fmt: skip
"""Path -> dtype, shape after N with R for the number of the header's regions, meaning."""


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
