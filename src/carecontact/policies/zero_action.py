"""The null arm that does nothing: whatever it scores is the benchmark's floor."""

from __future__ import annotations

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard


class ZeroAction:
    """Keeps the parked pose, sees nothing and is never done, so every trial runs to its time limit."""

    card = PolicyCard(name="zero-action", cameras=(), control_hz=1.0)

    def reset(self, instruction: str) -> None:
        """The instruction makes no difference."""

    def act(self, observation: Observation) -> list[Action]:
        """Half a minute of keeping the last target: one answer for a usual trial."""
        return [Action()] * 30
