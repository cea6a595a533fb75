"""Targets for the Cartesian impedance: a pose of the tool and, if the policy likes, its stiffness."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action, ActionBounds, check_action, clip_action
from carecontact.contract.protocol import Protocol
from carecontact.episode.spaces.space import SPACES, ActionSpace
from carecontact.sim.simulation import Simulation


class CartesianPose(ActionSpace):
    """The impedance's target moves to the pose of each action, no faster than the protocol allows."""

    control = "cartesian-impedance"

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        impedance = simulation.protocol.impedance
        self._stiffness = (impedance.translational_n_m, impedance.rotational_nm_rad)

    @property
    def bounds(self) -> ActionBounds:
        return bounds_of(self.simulation.protocol)

    def check(self, action: Action) -> Action:
        return check_action(action, self.bounds)

    def clip(self, action: Action) -> Action:
        return clip_action(action, self.bounds)

    def apply(self, action: Action, period_s: float) -> Mapping[str, npt.NDArray[np.float64]]:
        if action.stiffness is not None and action.stiffness != self._stiffness:
            self._stiffness = action.stiffness
            self.simulation.set_stiffness(*action.stiffness)
        self.simulation.set_goal(action.pose_tcp_in_base, period_s)
        pose = np.full(7, np.nan) if action.pose_tcp_in_base is None else action.pose_tcp_in_base
        return {"actions/pose_tcp_in_base": pose, "actions/stiffness": np.array(self._stiffness)}


def bounds_of(protocol: Protocol) -> ActionBounds:
    """The workspace and the stiffness that a protocol allows."""
    impedance = protocol.impedance
    return ActionBounds(
        workspace_low_m=impedance.workspace_low_m,
        workspace_high_m=impedance.workspace_high_m,
        translational_stiffness=impedance.translational_bounds,
        rotational_stiffness=impedance.rotational_bounds,
    )


SPACES.register("cartesian_pose", CartesianPose)
