"""A policy that another process can import: it ends each trial at once."""

from __future__ import annotations

from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard


class Still:
    card = PolicyCard(name="still")

    def __init__(self, steps: int = 1) -> None:
        self.instructions: list[str] = []

    def reset(self, instruction: str) -> None:
        self.instructions.append(instruction)

    def act(self, observation: object) -> Action:
        return Action(done=True)
