"""The blind baseline that repeats actions of the state machine at another arm angle: a gate that it passes does not
need vision."""

from __future__ import annotations

import io
from importlib import resources

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.errors import ContractError

CONTROL_HZ = 20.0
"""Rate at which the actions were recorded [Hz]."""
ACTIONS = "actions.npz"
"""File that maps an instruction to (n, 9) actions: pose of the tool in base (7), translational stiffness [N/m] and
rotational stiffness [N m/rad]; NaN where an action kept the last value. tools/record_replay.py writes it."""


def recorded_actions() -> dict[str, npt.NDArray[np.float64]]:
    """Return the (n, 9) actions of each recorded instruction, as ACTIONS describes them."""
    data = (resources.files(__package__ or __name__) / ACTIONS).read_bytes()
    with np.load(io.BytesIO(data)) as arrays:
        return {name: arrays[name].astype(np.float64) for name in arrays.files}


class Replay:
    """Repeats the actions that were recorded for the same task with a seed that no shipped protocol contains."""

    card = PolicyCard(name="replay", cameras=(), control_hz=CONTROL_HZ)

    def __init__(self) -> None:
        self._actions: npt.NDArray[np.float64] | None = None

    def reset(self, instruction: str) -> None:
        """Choose the recording. Raises ContractError for an instruction that was not recorded."""
        known = recorded_actions()
        if instruction not in known:
            raise ContractError(
                f"replay has no recorded actions for the instruction {instruction!r}; valid: {', '.join(sorted(known))}"
            )
        self._actions = known[instruction]

    def act(self, observation: Observation) -> list[Action]:
        """Return all recorded actions as one chunk, of which the last one ends the trial."""
        if self._actions is None:
            raise ContractError("act() was called before reset()")
        last = len(self._actions) - 1
        return [
            Action(
                pose_tcp_in_base=None if np.isnan(row[0]) else _unit(row[:7]),
                stiffness=None if np.isnan(row[7]) else (float(row[7]), float(row[8])),
                done=k == last,
            )
            for k, row in enumerate(self._actions)
        ]


def _unit(pose: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    # The file stores single precision, in which the quaternion's norm is not 1 to the last bit of a double.
    return np.concatenate([pose[:3], pose[3:] / np.linalg.norm(pose[3:])])
