"""How a policy's actions become commands of the robot's controller."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action, ActionBounds
from carecontact.registry import Registry
from carecontact.sim.simulation import Simulation


class ActionSpace(ABC):
    """Validates actions, publishes their bounds and drives the controller of one simulation."""

    control: ClassVar[str]
    """Id of the controller, as it stands in the recording."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation

    @property
    @abstractmethod
    def bounds(self) -> ActionBounds:
        """Limits that the policy learns before its first action."""

    @abstractmethod
    def check(self, action: Action) -> Action:
        """The action in normal form. Raises ActionError naming the field, what was expected and what was got."""

    @abstractmethod
    def clip(self, action: Action) -> Action:
        """The action moved into the space's bounds, for a card whose ``out_of_bounds`` is ``clip``; the same object if
        nothing has to be moved."""

    @abstractmethod
    def apply(self, action: Action, period_s: float) -> Mapping[str, npt.NDArray[np.float64]]:
        """Make a checked action the controller's command for one period of the policy's control rate.

        Returns:
            Array path of a recording -> the entry that this action adds to it.
        """


SPACES: Registry[type[ActionSpace]] = Registry(
    "action space", plural="action_spaces", scan="carecontact.episode.spaces"
)
"""Name on a policy's card -> class."""
