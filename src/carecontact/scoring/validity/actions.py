"""Checks whether a policy can have sent the recorded actions, by the rules by which a trial accepts them."""

from __future__ import annotations

import numpy as np

from carecontact.contract.action.spaces.cartesian_pose import allowed_stiffness
from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring.validity.values import ROOM_M

PER_AXIS = "actions/axis_stiffness"


def check_actions(recording: Recording) -> None:
    """Raises RecordingError for an action that the trial would have refused.

    Valid is a pose within the room, or NaN in all seven numbers where the last target was kept, with a stiffness that
    ``allowed_stiffness`` accepts; for a joint space, seven finite joint numbers or NaN in all of them, and neither pose
    nor stiffness.
    """
    trial_id = recording.header.spec.trial_id
    pose, stiffness = recording["actions/pose_tcp_in_base"], recording["actions/stiffness"]
    joint = recording.arrays.get("actions/joint")
    if joint is not None:
        wrong = ~(np.isfinite(joint).all(axis=1) | np.isnan(joint).all(axis=1))
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise RecordingError(
                f"{trial_id}: actions/joint holds {joint[row].tolist()} at {row}; valid: seven finite numbers, or NaN "
                "in all seven where the last target was kept"
            )
        if np.isfinite(pose).any() or np.isfinite(stiffness).any():
            raise RecordingError(f"{trial_id}: actions in joint space have neither a pose nor a stiffness; valid: NaN")
        return
    kept = np.isnan(pose).all(axis=1)
    wrong = ~kept & ~(np.abs(pose) <= ROOM_M).all(axis=1)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise RecordingError(
            f"{trial_id}: actions/pose_tcp_in_base holds {pose[row].tolist()} at {row}; valid: seven numbers, "
            f"positions of at most {ROOM_M:g} m, or NaN in all seven where the last target was kept"
        )
    path = PER_AXIS if PER_AXIS in recording else "actions/stiffness"
    wrong = ~allowed_stiffness(recording[path], bounds := recording.header.spec.protocol.impedance.action_bounds).all(
        axis=1
    )
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        (low, high), (low_turn, high_turn) = bounds.translational_stiffness, bounds.rotational_stiffness
        raise RecordingError(
            f"{trial_id}: {path} holds {recording[path][row].tolist()} at {row}; valid: {low:g} to {high:g} N/m and "
            f"{low_turn:g} to {high_turn:g} N m/rad{', or 0 on an axis' if path == PER_AXIS else ''}"
        )
