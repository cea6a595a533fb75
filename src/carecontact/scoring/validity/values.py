"""Checks whether the values of a stream are possible: finite, within bounds, unit quaternions, valid ranges."""

from __future__ import annotations

from math import inf, pi

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording import Recording

QUAT_TOLERANCE = 1e-3
ANGLE_ROUNDING_RAD = 1e-6
ROOM_M = 5.0
"""Largest distance of anything from the world's origin, the robot's base or a joint's centre; real scenes reach 1 m."""
BOUNDS: dict[str, tuple[float, float, str]] = {
    "scorer/normal_force": (0.0, inf, "N, a sum of magnitudes"),
    "scorer/centroid_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/human_joint_position": (-2 * pi, 2 * pi, "rad"),
    "scorer/human_joint_range": (-2 * pi, 2 * pi, "rad"),
    "scorer/human_joint_settled": (-2 * pi, 2 * pi, "rad"),
    "scorer/wrist_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/wrist_settled_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/pose_tcp_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/tcp_speed": (0.0, inf, "m/s"),
    "scorer/tcp_rotation_speed": (0.0, inf, "rad/s"),
    "scorer/region_pose_in_world": (-ROOM_M, ROOM_M, "m"),
    "scorer/region_size_m": (0.001, 1.0, "m"),
    "scorer/indentation_m": (0.0, inf, "m"),
    "scorer/target_in_base": (-ROOM_M, ROOM_M, "m"),
}
"""Array -> lowest and highest value [unit]. What is refused, no policy can bring about: another sign, or a place
outside the room."""
TARGETS = ("actions/pose_tcp_in_base", "actions/joint")
ACTIONS = (*TARGETS, "actions/time_s", "actions/stiffness", "actions/axis_stiffness")
CELLS = ("area_m2", "press_ns", "shear_ns", "slip_m3", "touch_m2s")
ROUNDING = 1e-3
"""Share by which the area in contact of a cell may exceed the cell's own, since both are sums of 32-bit floats."""


def check_finite_streams(recording: Recording) -> None:
    """Raises RecordingError for a value in a scorer stream or of an action that is not finite. NaN in a whole row says
    that an action kept the last target, or that actions in joint space have no stiffness."""
    may_lack = ACTIONS if "actions/joint" in recording else TARGETS
    for path in sorted(recording.arrays):
        array = recording.arrays[path]
        if not (path.startswith("scorer/") or path in ACTIONS) or array.dtype.kind != "f":
            continue
        finite = np.isfinite(array)
        if path in may_lack and path != "actions/time_s":
            finite |= np.isnan(array).all(axis=1, keepdims=True)
        if not finite.all():
            place = _first(~finite)
            trial_id = recording.header.spec.trial_id
            raise RecordingError(f"{trial_id}: {path} holds {array[place]} at {place}; every value must be finite")


def check_bounds(recording: Recording) -> None:
    """Raises RecordingError for a value outside BOUNDS, or a base of the robot outside the room."""
    trial_id = recording.header.spec.trial_id
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


def check_cells(recording: Recording) -> None:
    """Raises RecordingError for a negative sum of a cell, and for a cell with more area in contact than it has."""
    arrays, trial_id = recording.arrays, recording.header.spec.trial_id
    for path in (path for name in CELLS if (path := f"scorer/cell_{name}") in arrays):
        if (arrays[path] < 0).any():
            place = _first(arrays[path] < 0)
            raise RecordingError(f"{trial_id}: {path} holds {arrays[path][place]:g} at {place}; valid: 0 or more")
    if "scorer/cell_touch_m2s" in arrays and len(arrays["scorer/period_time_s"]):
        period = np.diff(arrays["scorer/period_time_s"], prepend=0.0)
        most = (1 + ROUNDING) * period[:, None] * arrays["scorer/cell_area_m2"]
        if (beyond := arrays["scorer/cell_touch_m2s"] > most).any():
            place = _first(beyond)
            raise RecordingError(
                f"{trial_id}: scorer/cell_touch_m2s holds {arrays['scorer/cell_touch_m2s'][place]:g} at {place}; "
                f"valid: at most the cell's area times the period, {most[place] / (1 + ROUNDING):g} m^2 s"
            )


def check_rotations(recording: Recording) -> None:
    """Raises RecordingError for a pose of the tool or of a region whose quaternion does not have length 1."""
    for path in ("scorer/pose_tcp_in_world", "scorer/region_pose_in_world"):
        quat = recording[path][..., 3:].astype(np.float64)
        wrong = np.abs(np.einsum("...i,...i", quat, quat) - 1.0) > QUAT_TOLERANCE
        if wrong.any():
            raise RecordingError(
                f"{recording.header.spec.trial_id}: {path} at {_first(wrong)} is not a rotation: quat_wxyz must have "
                "length 1"
            )


def check_joint_ranges(recording: Recording) -> None:
    """Raises RecordingError for a joint whose range ends below its start."""
    low, high = recording["scorer/human_joint_range"].T
    for joint in np.flatnonzero(low >= high).tolist():
        raise RecordingError(
            f"{recording.header.spec.trial_id}: scorer/human_joint_range of {recording.header.human_joints[joint]} is "
            f"{low[joint]:g} to {high[joint]:g} rad; expected low below high"
        )


def check_reactions(recording: Recording) -> None:
    """Raises RecordingError for an end stop that pushes inside a joint's range, or out of it. Recordings need not have
    the array."""
    reaction = recording.arrays.get("scorer/human_joint_reaction")
    if reaction is None:
        return
    position = recording["scorer/human_joint_position"].astype(np.float64)
    low, high = recording["scorer/human_joint_range"].T
    # Positions are stored as float32: at an end they are off by less than this.
    inward = np.where(position > high - ANGLE_ROUNDING_RAD, reaction <= 0, reaction == 0)
    inward |= (position < low + ANGLE_ROUNDING_RAD) & (reaction >= 0)
    if not inward.all():
        step, joint = _first(~inward)
        raise RecordingError(
            f"{recording.header.spec.trial_id}: scorer/human_joint_reaction holds {reaction[step, joint]:g} N m for "
            f"{recording.header.human_joints[joint]} at {position[step, joint]:g} rad; expected 0 inside "
            f"{low[joint]:g} to {high[joint]:g} rad, and a torque back into it outside"
        )


def _first(wrong: npt.NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.argwhere(wrong)[0])
