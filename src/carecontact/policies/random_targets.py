"""The null arm that moves about: what it passes, a gate gives away."""

from __future__ import annotations

import hashlib

import numpy as np

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard, Session
from carecontact.errors import ContractError

CAMERA = "overhead"
NEW_TARGET_S = 1.0
"""At the session's speed limit some 0.25 m of way."""
POINTING_DOWN = np.array([0.0, 1.0, 0.0, 0.0])


class RandomTargets:
    """A new target every NEW_TARGET_S, uniform over the workspace, the tool pointing down, until time is over.

    The numbers come from what it is told and sees first: nothing else differs between trials that a policy may know.
    """

    card = PolicyCard(name="random", modalities=("depth",), cameras=(CAMERA,), control_hz=1.0 / NEW_TARGET_S)

    def __init__(self) -> None:
        self._session: Session | None = None
        self._instruction = ""

    def configure(self, session: Session) -> None:
        self._session = session

    def reset(self, instruction: str) -> None:
        self._instruction = instruction

    def act(self, observation: Observation) -> list[Action]:
        """The whole trial as one chunk."""
        depth = observation.cameras[CAMERA].depth
        if self._session is None or depth is None:
            raise ContractError("act() needs a session and the depth image that the card names")
        digest = hashlib.sha256(self._instruction.encode() + depth.tobytes()).digest()
        rng = np.random.default_rng(np.frombuffer(digest, np.uint32))
        bounds = self._session.action_bounds
        count = int(np.ceil(self._session.time_limit_s / NEW_TARGET_S))
        targets = rng.uniform(bounds.workspace_low_m, bounds.workspace_high_m, (count, 3))
        return [Action(pose_tcp_in_base=np.concatenate([target, POINTING_DOWN])) for target in targets]
