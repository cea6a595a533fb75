"""Actions that the state machine took for another posture, repeated blindly: what they pass needs no eyes."""

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
"""At which the actions were taken."""
ACTIONS = "actions.npz"
"""Instruction -> (n, 9): pose of the tool in base, translational and rotational stiffness; NaN where it kept the
last one. Written by tools/record_replay.py."""


def recorded_actions() -> dict[str, npt.NDArray[np.float64]]:
    data = (resources.files(__package__ or __name__) / ACTIONS).read_bytes()
    with np.load(io.BytesIO(data)) as arrays:
        return {name: arrays[name].astype(np.float64) for name in arrays.files}


class Replay:
    """One task's actions from a seed that no shipped protocol has, as one chunk, the last of them done."""

    card = PolicyCard(name="replay", cameras=(), control_hz=CONTROL_HZ)

    def __init__(self) -> None:
        self._actions: npt.NDArray[np.float64] | None = None

    def reset(self, instruction: str) -> None:
        """Raises ContractError for an instruction that was not recorded."""
        known = recorded_actions()
        if instruction not in known:
            raise ContractError(f"nothing was recorded for {instruction!r}; there is: {', '.join(sorted(known))}")
        self._actions = known[instruction]

    def act(self, observation: Observation) -> list[Action]:
        if self._actions is None:
            raise ContractError("act() before reset()")
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
    # Stored in single precision.
    return np.concatenate([pose[:3], pose[3:] / np.linalg.norm(pose[3:])])
