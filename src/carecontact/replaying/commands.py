"""What a recorded policy commanded, as actions that a driver takes again."""

from __future__ import annotations

from typing import Any

import numpy as np

from carecontact.contract.action import Action
from carecontact.recording.schema import Recording


def recorded_actions(recording: Recording) -> list[Action]:
    """Return the executed actions of a trial, in their order.

    Stiffness, damping and feedforward are those in force, so that an action which kept them gives them again.
    """
    return [_action(recording, row) for row in range(len(recording["actions/time_s"]))]


def _action(recording: Recording, row: int) -> Action:
    arrays = recording.arrays

    def at(path: str) -> Any:
        """Return the entry of this action, None where nothing was commanded."""
        if path not in arrays or np.isnan(arrays[path][row]).any():
            return None
        return np.array(arrays[path][row])

    if "actions/joint" in arrays:
        return Action(joint=at("actions/joint"))
    stiffness, damping = at("actions/axis_stiffness"), at("actions/damping_ratio")
    if stiffness is None:
        stiffness = at("actions/stiffness")
    return Action(
        pose_tcp_in_base=at("actions/pose_tcp_in_base"),
        stiffness=None if stiffness is None else tuple(stiffness.tolist()),
        damping_ratio=None if damping is None else float(damping),
        wrench_in_tcp=at("actions/wrench_in_tcp"),
    )
