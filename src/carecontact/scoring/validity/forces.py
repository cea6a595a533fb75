"""Checks whether a recording's force vectors, its sums of normal forces and its end agree with each other."""

from __future__ import annotations

from math import hypot

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.recording.schema import CUTS
from carecontact.scoring.filters import F64

MOST_FRICTION, MOST_BRAKE = 2.0, 2.0
"""The largest coefficient that a protocol may have, and the brake of a tool that lets skin in (``STEEPEST`` in
kernel/c/entry.c), both over the normal force: with both a contact's force is sqrt(17) of its normal part."""
ROUNDING_N = 0.01
BESIDE = ("scorer/beside_force_in_world", "scorer/beside_normal_force")
"""What other parts of the robot than its tip did."""
CUT_ROUNDING = 1e-5


def check_forces(recording: Recording) -> None:
    """Raises RecordingError naming the trial, the segment and the time where the forces contradict one another.

    They do where no friction explains a vector sum; where force or cause do not match an early stop by the benchmark;
    where a force is above the truncation limit in a trial that was not truncated; and where hand and links of the
    robot did more than the whole robot. A vector sum far below the normal
    sum is no contradiction: a policy may press from two sides.
    """
    force, normal = recording["scorer/force_human_from_robot_in_world"], recording["scorer/normal_force"]
    loaded = np.flatnonzero((force != 0).any(axis=0).any(axis=1) | (normal != 0).any(axis=0)).tolist()
    _check_parts(recording, normal)
    peaks: dict[str, float] = {}
    for column in loaded:
        norm = np.linalg.norm(force[:, column].astype(np.float64), axis=1)
        peaks[recording.header.segments[column]] = float(norm.max())
        _check_segment(recording, column, norm, normal[:, column])
    _check_end(recording, peaks)


def _check_parts(recording: Recording, normal: npt.NDArray[np.float32]) -> None:
    """What hand and links did is a part of the whole, and both of its arrays are there or none."""
    trial_id = recording.header.spec.trial_id
    there = [path in recording for path in BESIDE]
    if any(there) != all(there):
        raise RecordingError(f"{trial_id}: has one of {' and '.join(BESIDE)}; expected both or none")
    if not any(there):
        return
    beside = recording[BESIDE[1]]
    wrong = (beside < 0).any(axis=1) | (beside.sum(axis=1) > normal + ROUNDING_N)
    if wrong.any():
        step, column = (int(i) for i in np.argwhere(wrong)[0])
        raise RecordingError(
            f"{trial_id}: {BESIDE[1]} holds {beside[step, :, column].tolist()} N on "
            f"{recording.header.segments[column]} at step {step}; valid: 0 or more, together at most the whole "
            f"{normal[step, column]:.4g} N"
        )


def _check_segment(recording: Recording, column: int, norm: F64, normal: npt.NDArray[np.float32]) -> None:
    header, time = recording.header, recording["scorer/time_s"]
    place = f"{header.spec.trial_id}: on {header.segments[column]}"
    most = hypot(1.0, MOST_FRICTION + MOST_BRAKE) * normal + ROUNDING_N
    wrong = np.flatnonzero(norm > most)
    if len(wrong):
        at = wrong[0]
        raise RecordingError(
            f"{place} scorer/force_human_from_robot_in_world is {norm[at]:.4g} N at {time[at]:.4g} s and "
            f"scorer/normal_force {normal[at]:.4g} N; with a friction of up to {MOST_FRICTION:g} and a "
            f"brake of up to {MOST_BRAKE:g} times it at most {most[at]:.4g} N"
        )


def _check_end(recording: Recording, peaks: dict[str, float]) -> None:
    header = recording.header
    trial_id, protocol = header.spec.trial_id, header.spec.protocol
    cut_n = {segment: protocol.phases.truncation_over_pain * protocol.f_pain(segment) for segment in peaks}
    if header.ended != "safety_truncation":
        for segment, peak in peaks.items():
            if peak > cut_n[segment] * (1 + CUT_ROUNDING):
                raise RecordingError(
                    f"{trial_id}: ended {header.ended!r} with {peak:.4g} N on {segment}; above {cut_n[segment]:g} N a "
                    "trial is truncated"
                )
        return
    kind = header.failure.kind if header.failure else None
    if kind not in CUTS:
        raise RecordingError(f"{trial_id}: ended 'safety_truncation' with failure {kind!r}; valid: {', '.join(CUTS)}")
    if kind == "force" and not any(peak > cut_n[s] * (1 - CUT_ROUNDING) for s, peak in peaks.items()):
        told = ", ".join(f"{peak:.4g} N of {cut_n[s]:g} on {s}" for s, peak in peaks.items()) or "none on any segment"
        raise RecordingError(
            f"{trial_id}: truncated because of a force, but none is above its truncation limit: {told}"
        )
