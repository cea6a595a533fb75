"""The blind baseline that does nothing; every other policy has to do better."""

from __future__ import annotations

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard


class ZeroAction:
    """Keeps the parked pose, sees nothing and never ends a trial, so that every trial runs to its time limit."""

    card = PolicyCard(name="zero-action", cameras=(), control_hz=1.0)

    def reset(self, instruction: str) -> None:
        """Ignore the instruction."""

    def act(self, observation: Observation) -> list[Action]:
        """Return 30 actions that keep the last target: at 1 Hz, half a minute, which is a usual trial."""
        return [Action()] * 30
