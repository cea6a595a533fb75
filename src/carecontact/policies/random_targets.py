"""The blind baseline that moves to random targets: a gate that it meets is too easy."""

from __future__ import annotations

import hashlib

import numpy as np

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ContractError

CAMERA = "overhead"
NEW_TARGET_S = 1.0
"""Time between two targets: at the session's speed limit, the tool moves about 0.25 m."""
POINTING_DOWN = np.array([0.0, 1.0, 0.0, 0.0])


class RandomTargets:
    """Moves to a new target every NEW_TARGET_S until time is up: uniform over the workspace, the tool pointing down.

    The instruction and the first depth image seed the random numbers: nothing else that a policy may know differs
    between trials.
    """

    card = PolicyCard(name="random", modalities=("depth",), cameras=(CAMERA,), control_hz=1.0 / NEW_TARGET_S)

    def __init__(self) -> None:
        self._session: Session | None = None
        self._instruction = ""

    def configure(self, session: Session) -> None:
        """Take over the workspace and the time limit."""
        self._session = session

    def reset(self, instruction: str) -> None:
        """Keep the instruction: it seeds the random numbers."""
        self._instruction = instruction

    def act(self, observation: Observation) -> list[Action]:
        """Return the targets of the whole trial as one chunk. Raises ContractError without a session or depth image."""
        depth = observation.cameras[CAMERA].depth
        if self._session is None or depth is None:
            raise ContractError(f"act() needs a session from configure() and the depth image of camera {CAMERA}")
        digest = hashlib.sha256(self._instruction.encode() + depth.tobytes()).digest()
        rng = np.random.default_rng(np.frombuffer(digest, np.uint32))
        bounds = self._session.action_bounds
        count = int(np.ceil(self._session.time_limit_s / NEW_TARGET_S))
        targets = rng.uniform(bounds.workspace_low_m, bounds.workspace_high_m, (count, 3))
        return [Action(pose_tcp_in_base=np.concatenate([target, POINTING_DOWN])) for target in targets]
