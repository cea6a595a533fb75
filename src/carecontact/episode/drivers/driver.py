"""How a policy's actions become commands of the robot's controller."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import ACTION_SPACES, Action
from carecontact.contract.policy import PolicyCard
from carecontact.sim.simulation import Simulation


class Driver(ABC):
    """Drives the controller of one simulation with the actions of one policy."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation

    def check(self, action: Action) -> None:  # noqa: B027 - most drivers refuse nothing more
        """Refuse an action that is valid by itself but not after those before it. Raises ActionError.

        Args:
            action: as its space's ``check`` returned it.
        """

    @abstractmethod
    def apply(self, action: Action, period_s: float) -> Mapping[str, npt.NDArray[np.float64]]:
        """Make a checked action the controller's command for one period of the policy's control rate.

        Returns:
            Array path of a recording -> the entry that this action adds to it; the same paths for every action.
        """

    @property
    def unused(self) -> frozenset[str]:
        """Return the paths of ``apply`` that no action has used so far; a recording that ends now leaves these arrays
        out.
        """
        return frozenset()


def driver_of(card: PolicyCard, simulation: Simulation) -> Driver:
    """Return a driver for the card's action space over a simulation that has the card's control."""
    module, _, name = ACTION_SPACES[card.action_space].driver.partition(":")
    return getattr(import_module(module), name)(simulation)
