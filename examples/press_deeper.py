"""A question to the exam: does the shipped script pass more if it commands every target a constant deeper?

    carecontact run --policy press_deeper:PressDeeper --policy-arg by_m=0.006 \\
        --protocol bathing-wide-v2 --level L2

from this folder. It is also an example of a policy that wraps another one.
"""

from collections.abc import Sequence
from dataclasses import replace

from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.robot import Session
from carecontact.policies.state_machine import StateMachine

LOWERED_OVER = 10
"""Actions over which the first targets are lowered, so that the robot does not start with a jump; one second."""


class PressDeeper:
    """The state machine, whose commanded targets all lie lower by a constant."""

    def __init__(self, *, by_m: float = 0.006) -> None:
        """``by_m``: how much lower [m]; a negative one presses less."""
        self._by_m, self._base = float(by_m), StateMachine()
        self.card = replace(self._base.card, name="press-deeper")

    def configure(self, session: Session) -> None:
        self._base.configure(session)

    def reset(self, instruction: str) -> None:
        self._base.reset(instruction)

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the plan of the state machine, lowered."""
        return [self._lowered(k, action) for k, action in enumerate(self._base.act(observation))]

    def take_notes(self) -> dict[str, object]:
        return self._base.take_notes()

    def _lowered(self, k: int, action: Action) -> Action:
        if action.pose_tcp_in_base is None:
            return action
        pose = action.pose_tcp_in_base.copy()
        pose[2] -= self._by_m * min(1.0, (k + 1) / LOWERED_OVER)
        return replace(action, pose_tcp_in_base=pose)
