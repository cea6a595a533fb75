"""Whether a simulation can have made a recording: its values, forces, times and streams."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from math import hypot, inf, pi

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.recording.schema import CUTS
from carecontact.scoring.contact import F64, rate_faults
from carecontact.scoring.metrics.success import broke_down

QUAT_TOLERANCE = 1e-3
ANGLE_ROUNDING_RAD = 1e-6
ROOM_M = 5.0
"""Largest distance of anything from the world's origin, the robot's base or a joint's centre; real scenes reach 1 m."""
PLACE = (-ROOM_M, ROOM_M, "m")
ANGLE = (-2 * pi, 2 * pi, "rad")
ROUNDING = 1e-3
"""Share by which an area in contact or under foam may exceed the cell's own, since both are sums of 32-bit floats."""
BOUNDS: dict[str, tuple[float, float, str]] = {
    "scorer/normal_force": (0.0, inf, "N, a sum of magnitudes"),
    "scorer/centroid_in_world": PLACE,
    "scorer/human_joint_position": ANGLE,
    "scorer/human_joint_range": ANGLE,
    "scorer/human_joint_settled": ANGLE,
    "scorer/wrist_in_world": PLACE,
    "scorer/wrist_settled_in_world": PLACE,
    "scorer/pose_tcp_in_world": PLACE,
    "scorer/tcp_speed": (0.0, inf, "m/s"),
    "scorer/tcp_rotation_speed": (0.0, inf, "rad/s"),
    "scorer/region_pose_in_world": PLACE,
    "scorer/region_size_m": (0.001, 1.0, "m"),
    "scorer/indentation_m": (0.0, inf, "m"),
    "scorer/target_in_base": PLACE,
    "scorer/cell_area_m2": (0.0, inf, "m^2"),
    "scorer/cell_press_ns": (0.0, inf, "N s"),
    "scorer/cell_shear_ns": (0.0, inf, "N s"),
    "scorer/cell_slip_m3": (0.0, inf, "m^3"),
    "scorer/cell_touch_m2s": (0.0, inf, "m^2 s"),
    "scorer/foam_cell_share": (0.0, 1 + ROUNDING, "of a cell"),
}
"""Array -> lowest and highest value [unit]. What is refused, no policy can bring about: another sign, or a place
outside the room."""
TARGETS = ("actions/pose_tcp_in_base", "actions/delta", "actions/joint")
ACTIONS = (*TARGETS, "actions/time_s", "actions/stiffness", "actions/axis_stiffness")
MOST_FRICTION, MOST_BRAKE = 2.0, 2.0
"""The largest coefficient that a protocol may have, and the brake of a tool that lets skin in (``STEEPEST`` in
tissue/c/entry.c), both over the normal force: with both a contact's force is sqrt(17) of its normal part."""
ROUNDING_N = 0.01
BESIDE = ("scorer/beside_force_in_world", "scorer/beside_normal_force")
"""What other parts of the robot than its tip did."""
CUT_ROUNDING = 1e-5
TIME_TOLERANCE_S = 1e-6
SHORTEST_STEP_S, LONGEST_STEP_S = 1e-5, 0.1
LATE_ACTION_S = 0.25
"""An action may be this much later than the trial's end: recordings with one exist, and they keep their score."""


def check_streams(recording: Recording) -> None:
    """Raises RecordingError naming trial, array, place and what is valid, within generous bounds (5 % of a force, 1 cm
    of a wrist). Whether an action may be executed is decided in ``Episode.step``."""
    check_finite_streams(recording)
    _raise_first(recording, _time_faults(recording))
    header = recording.header
    diverged = header.ended == "safety_truncation" and header.failure is not None and header.failure.kind == "solver"
    # Diverging physics knows no bounds. Refused, such a trial would be lost; scored, it is a failed one.
    if len(recording["scorer/time_s"]) == 0 or diverged:
        return
    checks = (_bound_faults, _cell_faults, _rotation_faults, _joint_faults, _force_faults)
    _raise_first(recording, chain.from_iterable(check(recording) for check in checks))


def check_finite_streams(recording: Recording) -> None:
    """Raises RecordingError for a value that is not finite; NaN in a whole row of an action is a kept target."""
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


def _raise_first(recording: Recording, faults: Iterator[str]) -> None:
    for fault in faults:
        raise RecordingError(f"{recording.header.spec.trial_id}: {fault}")


def _first(wrong: npt.NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.argwhere(wrong)[0])


# Whether the values of a stream are possible: within bounds, unit quaternions, valid ranges.


def _bound_faults(recording: Recording) -> Iterator[str]:
    for path, (low, high, unit) in BOUNDS.items():
        if path not in recording:  # the schema requires those of every trial
            continue
        array = recording[path]
        # By the extremes: they need no array of their own, and a good recording has nothing to look for.
        if array.size and not (array.min() >= low and array.max() <= high):
            place = _first((array < low) | (array > high))
            yield f"{path} holds {array[place]:g} at {place}; valid: {low:g} to {high:g} {unit}"
    base = recording.header.pose_base_in_world
    if max(abs(number) for number in base) > ROOM_M:
        yield f"pose_base_in_world holds {base}; valid: positions of at most {ROOM_M:g} m, quat_wxyz"


def _cell_faults(recording: Recording) -> Iterator[str]:
    """A cell with more area in contact than it has."""
    arrays = recording.arrays
    if "scorer/cell_touch_m2s" in arrays and len(arrays["scorer/period_time_s"]):
        touch, period = arrays["scorer/cell_touch_m2s"], np.diff(arrays["scorer/period_time_s"], prepend=0.0)
        most = (1 + ROUNDING) * period[:, None] * arrays["scorer/cell_area_m2"]
        if (touch > most).any():
            place = _first(touch > most)
            yield (
                f"scorer/cell_touch_m2s holds {touch[place]:g} at {place}; valid: at most the cell's area times the "
                f"period, {most[place] / (1 + ROUNDING):g} m^2 s"
            )


def _rotation_faults(recording: Recording) -> Iterator[str]:
    poses = ("scorer/pose_tcp_in_world", "scorer/region_pose_in_world", "scorer/foam_pose_in_region")
    for path in (path for path in poses if path in recording):
        quat = recording[path][..., 3:].astype(np.float64)
        wrong = np.abs(np.einsum("...i,...i", quat, quat) - 1.0) > QUAT_TOLERANCE
        if wrong.any():
            yield f"{path} at {_first(wrong)} is not a rotation: quat_wxyz must have length 1"


def _joint_faults(recording: Recording) -> Iterator[str]:
    """A range that ends below its start, and an end stop that pushes inside a joint's range, or out of it."""
    low, high = recording["scorer/human_joint_range"].T
    names = recording.header.human_joints
    for joint in np.flatnonzero(low >= high).tolist():
        yield (
            f"scorer/human_joint_range of {names[joint]} is {low[joint]:g} to {high[joint]:g} rad; expected low below "
            "high"
        )
    reaction = recording.arrays.get("scorer/human_joint_reaction")
    if reaction is None:
        return
    position = recording["scorer/human_joint_position"].astype(np.float64)
    # Positions are stored as float32: at an end they are off by less than this.
    inward = np.where(position > high - ANGLE_ROUNDING_RAD, reaction <= 0, reaction == 0)
    inward |= (position < low + ANGLE_ROUNDING_RAD) & (reaction >= 0)
    if not inward.all():
        step, joint = _first(~inward)
        yield (
            f"scorer/human_joint_reaction holds {reaction[step, joint]:g} N m for {names[joint]} at "
            f"{position[step, joint]:g} rad; expected 0 inside {low[joint]:g} to {high[joint]:g} rad, and a torque "
            "back into it outside"
        )


# Whether force vectors, sums of normal forces and the end of the trial agree.


def _force_faults(recording: Recording) -> Iterator[str]:
    """Forces that friction or the trial's end do not explain. A policy may press from two sides: a small sum is no
    fault."""
    header, time = recording.header, recording["scorer/time_s"]
    force, normal = recording["scorer/force_human_from_robot_in_world"], recording["scorer/normal_force"]
    yield from _part_faults(recording, normal)
    peaks: dict[str, float] = {}
    for column in np.flatnonzero((force != 0).any(axis=0).any(axis=1) | (normal != 0).any(axis=0)).tolist():
        segment = header.segments[column]
        norm = np.linalg.norm(force[:, column].astype(np.float64), axis=1)
        peaks[segment] = float(norm.max())
        most = hypot(1.0, MOST_FRICTION + MOST_BRAKE) * normal[:, column] + ROUNDING_N
        wrong = np.flatnonzero(norm > most)
        if len(wrong):
            at = wrong[0]
            yield (
                f"on {segment} scorer/force_human_from_robot_in_world is {norm[at]:.4g} N at {time[at]:.4g} s and "
                f"scorer/normal_force {normal[at, column]:.4g} N; with a friction of up to {MOST_FRICTION:g} and a "
                f"brake of up to {MOST_BRAKE:g} times it at most {most[at]:.4g} N"
            )
    yield from _end_faults(recording, peaks)


def _part_faults(recording: Recording, normal: npt.NDArray[np.float32]) -> Iterator[str]:
    """What hand and links did is a part of the whole, and both of its arrays are there or none."""
    there = [path in recording for path in BESIDE]
    if any(there) != all(there):
        yield f"has one of {' and '.join(BESIDE)}; expected both or none"
    if not any(there):
        return
    beside = recording[BESIDE[1]]
    wrong = (beside < 0).any(axis=1) | (beside.sum(axis=1) > normal + ROUNDING_N)
    if wrong.any():
        step, column = _first(wrong)
        yield (
            f"{BESIDE[1]} holds {beside[step, :, column].tolist()} N on {recording.header.segments[column]} at step "
            f"{step}; valid: 0 or more, together at most the whole {normal[step, column]:.4g} N"
        )


def _end_faults(recording: Recording, peaks: dict[str, float]) -> Iterator[str]:
    """A force above the truncation limit in a trial that was not truncated, and a truncation without one."""
    header, protocol = recording.header, recording.header.spec.protocol
    cut_n = {segment: protocol.phases.truncation_over_pain * protocol.f_pain(segment) for segment in peaks}
    if header.ended != "safety_truncation":
        for segment, peak in peaks.items():
            if peak > cut_n[segment] * (1 + CUT_ROUNDING):
                yield (
                    f"ended {header.ended!r} with {peak:.4g} N on {segment}; above {cut_n[segment]:g} N a trial is "
                    "truncated"
                )
        return
    kind = header.failure.kind if header.failure else None
    if kind not in CUTS:
        yield f"ended 'safety_truncation' with failure {kind!r}; valid: {', '.join(CUTS)}"
    if kind == "force" and not any(peak > cut_n[s] * (1 - CUT_ROUNDING) for s, peak in peaks.items()):
        found = ", ".join(f"{peak:.4g} N of {cut_n[s]:g} on {s}" for s, peak in peaks.items()) or "none on any segment"
        yield f"truncated because of a force, but none is above its truncation limit: {found}"


# Whether one clock runs from t = 0 to the end of the trial, and no time lies outside it.


def _time_faults(recording: Recording) -> Iterator[str]:
    """Samples, periods, actions and observations that do not follow one clock from t = 0 to the trial's end."""
    protocol = recording.header.spec.protocol
    dt, limit_s = protocol.physics.dt_s, protocol.phases.time_limit_s
    if not SHORTEST_STEP_S <= dt <= LONGEST_STEP_S:
        yield f"physics.dt_s is {dt:g} s; valid: {SHORTEST_STEP_S:g} to {LONGEST_STEP_S:g}"
    yield from rate_faults(protocol)
    time: F64 = recording["scorer/time_s"]
    wrong = np.flatnonzero(np.abs(np.diff(time) - dt) > TIME_TOLERANCE_S)
    if len(wrong):
        step_s = time[wrong[0] + 1] - time[wrong[0]]
        yield f"scorer/time_s steps by {step_s:.6g} s after sample {wrong[0]}, expected {dt:g} s"
    if len(time):
        # A sample's time is the start of its step; scripted signals begin one step later.
        if not -TIME_TOLERANCE_S <= time[0] <= dt + TIME_TOLERANCE_S:
            yield f"scorer/time_s begins at {time[0]:g} s; valid: 0 or one step of {dt:g} s"
        if time[-1] > limit_s + dt + TIME_TOLERANCE_S:
            yield f"scorer/time_s ends at {time[-1]:g} s; the time limit is {limit_s:g} s"
        yield from _period_faults(recording, time, dt=dt, period_s=protocol.physics.target_period_s)
    elif not broke_down(recording.header):
        yield (
            f"ended {recording.header.ended!r} without a sample in scorer/time_s; only a trial whose policy, harness "
            "or solver failed has none"
        )
    end = float(time[-1]) if len(time) else 0.0
    for path, late in (("actions/time_s", LATE_ACTION_S), ("policy/observation_time_s", dt)):
        yield from _faults_inside(path, recording[path], end=end + late)


def _period_faults(recording: Recording, time: F64, *, dt: float, period_s: float) -> Iterator[str]:
    path, end = "scorer/period_time_s", float(time[-1])
    periods: F64 = recording[path]
    gaps = np.diff(periods, prepend=0.0)
    wrong = np.flatnonzero((gaps <= 0) | (gaps > period_s + TIME_TOLERANCE_S))
    if len(wrong):
        yield (
            f"{path} holds {periods[wrong[0]]:g} s at {wrong[0]}, {gaps[wrong[0]]:g} s after what is before it; valid: "
            f"above 0 and up to the {period_s:g} s of a period"
        )
    last = float(periods[-1]) if len(periods) else 0.0
    if not end - period_s - TIME_TOLERANCE_S <= last <= end + dt + TIME_TOLERANCE_S:
        yield f"{path} ends at {last:g} s and scorer/time_s at {end:g} s; one of them is incomplete"


def _faults_inside(path: str, times: F64, *, end: float) -> Iterator[str]:
    back = np.flatnonzero(np.diff(times) < 0)
    if len(back):
        yield f"{path} runs back from {times[back[0]]:g} to {times[back[0] + 1]:g} s at {back[0] + 1}"
    outside = np.flatnonzero(~((times >= -TIME_TOLERANCE_S) & (times <= end + TIME_TOLERANCE_S)))
    if len(outside):
        yield f"{path} holds {times[outside[0]]:g} s at {outside[0]}, outside the trial: 0 to {end:g} s"
