"""What the scorer's streams must hold before a number is made of them."""

from __future__ import annotations

import numpy as np

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring.filters import rate_faults

TIME_TOLERANCE_S = 1e-6
QUAT_TOLERANCE = 1e-3
SHORTEST_STEP_S, LONGEST_STEP_S = 1e-5, 0.1


def check_streams(recording: Recording) -> None:
    """Raises RecordingError naming the trial, the array and the sample: not finite, samples that are not one physics
    step apart, a rotation that is none, a negative normal force, a region without size, definitions that the sample
    rate cannot serve."""
    trial_id = recording.header.spec.trial_id
    for path in sorted(recording.arrays):
        array = recording.arrays[path]
        if not (path.startswith("scorer/") or path == "actions/time_s") or array.dtype.kind != "f":
            continue
        finite = np.isfinite(array)
        if not finite.all():
            first = tuple(int(i) for i in np.argwhere(~finite)[0])
            raise RecordingError(f"{trial_id}: {path} holds {array[first]} at {first}; every value must be finite")
    _check_rates(recording, trial_id)
    if len(recording["scorer/time_s"]) == 0:
        return
    for path in ("scorer/pose_tcp_in_world", "scorer/region_pose_in_world"):
        quat = recording[path][..., 3:].astype(np.float64)
        wrong = np.abs(np.einsum("...i,...i", quat, quat) - 1.0) > QUAT_TOLERANCE
        if wrong.any():
            first = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise RecordingError(f"{trial_id}: {path} at {first} is no rotation: quat_wxyz must have length 1")
    if (recording["scorer/normal_force"] < 0).any():
        raise RecordingError(f"{trial_id}: scorer/normal_force is negative somewhere; it is a sum of magnitudes")
    if (recording["scorer/region_size_m"] <= 0).any():
        raise RecordingError(f"{trial_id}: scorer/region_size_m holds a size that is not above 0")


def _check_rates(recording: Recording, trial_id: str) -> None:
    protocol = recording.header.spec.protocol
    dt = protocol.physics.dt_s
    if not SHORTEST_STEP_S <= dt <= LONGEST_STEP_S:
        raise RecordingError(f"{trial_id}: physics.dt_s is {dt:g} s; valid: {SHORTEST_STEP_S:g} to {LONGEST_STEP_S:g}")
    for fault in rate_faults(protocol):
        raise RecordingError(f"{trial_id}: {fault}")
    gaps = np.diff(recording["scorer/time_s"])
    wrong = np.flatnonzero(np.abs(gaps - dt) > TIME_TOLERANCE_S)
    if len(wrong):
        raise RecordingError(
            f"{trial_id}: scorer/time_s steps by {gaps[wrong[0]]:.6g} s after sample {wrong[0]}, expected {dt:g} s"
        )
