"""Checks the times in a recording: one clock runs from t = 0 to the end of the trial, and no time lies outside it."""

from __future__ import annotations

import numpy as np

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring.filters import F64, rate_faults
from carecontact.scoring.metrics.c3_success import broke_down

TIME_TOLERANCE_S = 1e-6
SHORTEST_STEP_S, LONGEST_STEP_S = 1e-5, 0.1
LATE_ACTION_S = 0.25
"""An action may be this much later than the trial's end: recordings with one exist, and they keep their score."""


def check_times(recording: Recording) -> None:
    """Raises RecordingError naming the trial, the array and the sample where the clocks contradict one another.

    Refused are definitions whose filters need a higher sample rate; samples that are not one physics step apart, begin
    elsewhere than at t = 0 or go on beyond the time limit; control periods that run back, leave a gap or end elsewhere
    than the samples; actions and observations that run back or lie outside the trial; and a trial without samples that
    did not fail.
    """
    trial_id, protocol = recording.header.spec.trial_id, recording.header.spec.protocol
    dt = protocol.physics.dt_s
    if not SHORTEST_STEP_S <= dt <= LONGEST_STEP_S:
        raise RecordingError(f"{trial_id}: physics.dt_s is {dt:g} s; valid: {SHORTEST_STEP_S:g} to {LONGEST_STEP_S:g}")
    for fault in rate_faults(protocol):
        raise RecordingError(f"{trial_id}: {fault}")
    time: F64 = recording["scorer/time_s"]
    wrong = np.flatnonzero(np.abs(np.diff(time) - dt) > TIME_TOLERANCE_S)
    if len(wrong):
        raise RecordingError(
            f"{trial_id}: scorer/time_s steps by {time[wrong[0] + 1] - time[wrong[0]]:.6g} s after sample {wrong[0]}, "
            f"expected {dt:g} s"
        )
    if len(time):
        _check_extent(trial_id, time, dt=dt, limit_s=protocol.phases.time_limit_s)
        _check_periods(recording, time, dt=dt, period_s=protocol.physics.target_period_s)
    elif not broke_down(recording.header):
        raise RecordingError(
            f"{trial_id}: ended {recording.header.ended!r} without a sample in scorer/time_s; only a trial whose "
            "policy, harness or solver failed has none"
        )
    end = float(time[-1]) if len(time) else 0.0
    for path, late in (("actions/time_s", LATE_ACTION_S), ("policy/observation_time_s", dt)):
        _check_inside(trial_id, path, recording[path], end=end + late)


def _check_extent(trial_id: str, time: F64, *, dt: float, limit_s: float) -> None:
    # A sample's time is the start of its step; one step later is allowed, as recordings of scripted signals have it.
    if not -TIME_TOLERANCE_S <= time[0] <= dt + TIME_TOLERANCE_S:
        raise RecordingError(f"{trial_id}: scorer/time_s begins at {time[0]:g} s; valid: 0 or one step of {dt:g} s")
    if time[-1] > limit_s + dt + TIME_TOLERANCE_S:
        raise RecordingError(f"{trial_id}: scorer/time_s ends at {time[-1]:g} s; the time limit is {limit_s:g} s")


def _check_periods(recording: Recording, time: F64, *, dt: float, period_s: float) -> None:
    trial_id, path, end = recording.header.spec.trial_id, "scorer/period_time_s", float(time[-1])
    periods: F64 = recording[path]
    gaps = np.diff(periods, prepend=0.0)
    wrong = np.flatnonzero((gaps <= 0) | (gaps > period_s + TIME_TOLERANCE_S))
    if len(wrong):
        raise RecordingError(
            f"{trial_id}: {path} holds {periods[wrong[0]]:g} s at {wrong[0]}, {gaps[wrong[0]]:g} s after what is "
            f"before it; valid: above 0 and up to the {period_s:g} s of a period"
        )
    last = float(periods[-1]) if len(periods) else 0.0
    if not end - period_s - TIME_TOLERANCE_S <= last <= end + dt + TIME_TOLERANCE_S:
        raise RecordingError(
            f"{trial_id}: {path} ends at {last:g} s and scorer/time_s at {end:g} s; one of them is incomplete"
        )


def _check_inside(trial_id: str, path: str, times: F64, *, end: float) -> None:
    back = np.flatnonzero(np.diff(times) < 0)
    if len(back):
        raise RecordingError(
            f"{trial_id}: {path} runs back from {times[back[0]]:g} to {times[back[0] + 1]:g} s at {back[0] + 1}"
        )
    outside = np.flatnonzero(~((times >= -TIME_TOLERANCE_S) & (times <= end + TIME_TOLERANCE_S)))
    if len(outside):
        raise RecordingError(
            f"{trial_id}: {path} holds {times[outside[0]]:g} s at {outside[0]}, outside the trial: 0 to {end:g} s"
        )
