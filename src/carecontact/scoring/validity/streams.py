"""What the scorer's streams must hold before a number is made of them."""

from __future__ import annotations

from math import inf, pi

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring.validity.stream_forces import check_forces
from carecontact.scoring.validity.stream_times import check_times

QUAT_TOLERANCE = 1e-3
ROOM_M = 5.0
"""Nothing is farther from the world's origin, the robot's base or a joint's centre than this; 1 m is what there is."""
MOST_STIFFNESS = 1e5
"""[N/m] and [N m/rad]"""
BOUNDS: dict[str, tuple[float, float, str]] = {
    "scorer/normal_force": (0.0, inf, "N, a sum of magnitudes"),
    "scorer/centroid_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/human_joint_position": (-2 * pi, 2 * pi, "rad"),
    "scorer/human_joint_range": (-2 * pi, 2 * pi, "rad"),
    "scorer/human_joint_settled": (-2 * pi, 2 * pi, "rad"),
    "scorer/wrist_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/wrist_settled_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/pose_tcp_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/tcp_speed": (0.0, 10.0, "m/s"),
    "scorer/tcp_rotation_speed": (0.0, 100.0, "rad/s"),
    "scorer/region_pose_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/region_size_m": (0.001, 1.0, "m"),
    "scorer/indentation_m": (0.0, 0.2, "m"),
    "scorer/target_in_base": (-ROOM_M, ROOM_M, "m"),
}
"""Array -> lowest and highest value [unit]. Generous: they tell another unit or another sign, not a bad trial."""


def check_streams(recording: Recording) -> None:
    """Raises RecordingError naming the trial, the array, the place in it and what would be valid.

    Values that are not finite or out of BOUNDS, a joint range whose ends are swapped, a rotation that is none, an
    action that no policy can have sent, and what ``check_times`` and ``check_forces`` raise. Wrong by less than the
    generous bounds (5 % on every force, a wrist shifted by 1 cm) is not told from right. Of a trial that the solver
    cut only that its values are finite and its clocks agree is asked.
    """
    trial_id = recording.header.spec.trial_id
    for path in sorted(recording.arrays):
        array = recording.arrays[path]
        if not (path.startswith("scorer/") or path == "actions/time_s") or array.dtype.kind != "f":
            continue
        finite = np.isfinite(array)
        if not finite.all():
            place = _first(~finite)
            raise RecordingError(f"{trial_id}: {path} holds {array[place]} at {place}; every value must be finite")
    _check_actions(recording, trial_id)
    check_times(recording)
    header = recording.header
    diverged = header.ended == "safety_truncation" and header.failure is not None and header.failure.kind == "solver"
    # Diverging physics knows no bounds. Refused, such a trial would be lost; scored, it is a failed one.
    if len(recording["scorer/time_s"]) == 0 or diverged:
        return
    _check_bounds(recording, trial_id)
    for path in ("scorer/pose_tcp_in_world", "scorer/region_pose_in_world"):
        quat = recording[path][..., 3:].astype(np.float64)
        wrong = np.abs(np.einsum("...i,...i", quat, quat) - 1.0) > QUAT_TOLERANCE
        if wrong.any():
            raise RecordingError(f"{trial_id}: {path} at {_first(wrong)} is no rotation: quat_wxyz must have length 1")
    low, high = recording["scorer/human_joint_range"].T
    for joint in np.flatnonzero(low >= high).tolist():
        raise RecordingError(
            f"{trial_id}: scorer/human_joint_range of {recording.header.human_joints[joint]} is {low[joint]:g} to "
            f"{high[joint]:g} rad; expected low below high"
        )
    check_forces(recording)


def _check_bounds(recording: Recording, trial_id: str) -> None:
    for path, (low, high, unit) in BOUNDS.items():
        array = recording[path]
        # By the extremes: they need no array of their own, and a good recording has nothing to look for.
        if array.size and not (array.min() >= low and array.max() <= high):
            place = _first((array < low) | (array > high))
            raise RecordingError(
                f"{trial_id}: {path} holds {array[place]:g} at {place}; valid: {low:g} to {high:g} {unit}"
            )
    base = recording.header.pose_base_in_world
    if max(abs(number) for number in base) > ROOM_M:
        raise RecordingError(
            f"{trial_id}: pose_base_in_world holds {base}; valid: positions of at most {ROOM_M:g} m, quat_wxyz"
        )


def _check_actions(recording: Recording, trial_id: str) -> None:
    """As ``contract.action.check_action`` let them into the trial: a pose, or none, and a stiffness above zero."""
    pose, stiffness = recording["actions/pose_tcp_in_base"], recording["actions/stiffness"]
    kept = np.isnan(pose).all(axis=1)
    wrong = ~kept & ~(np.abs(pose) <= ROOM_M).all(axis=1)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise RecordingError(
            f"{trial_id}: actions/pose_tcp_in_base holds {pose[row].tolist()} at {row}; valid: seven numbers, "
            f"positions of at most {ROOM_M:g} m, or NaN in all seven where the last target was kept"
        )
    wrong = ~((stiffness > 0) & (stiffness <= MOST_STIFFNESS)).all(axis=1)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise RecordingError(
            f"{trial_id}: actions/stiffness holds {stiffness[row].tolist()} at {row}; "
            f"valid: above 0 and up to {MOST_STIFFNESS:g}"
        )


def _first(wrong: npt.NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.argwhere(wrong)[0])
