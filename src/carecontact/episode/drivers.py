"""How a checked action becomes a command of the controller, for each action space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError, ConfigError
from carecontact.interface.action import ACTION_SPACES, Action
from carecontact.interface.policy import PolicyCard
from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]

AXES = ("x", "y", "z", "about x", "about y", "about z")
PER_AXIS, DAMPING, WRENCH = "actions/axis_stiffness", "actions/damping_ratio", "actions/wrench_in_tcp"
DROID_STEP_RAD = 0.2
"""Change of the target [rad] in one control period at a normalised velocity of 1 (``relative_max_joint_delta`` in
DROID's droid/robot_ik/robot_ik_solver.py)."""


class Driver(ABC):
    """Drives the controller of one simulation with the actions of one policy."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.unused: set[str] = set()
        """The paths of ``apply`` that no action has used so far, which the recording leaves out."""

    def check(self, action: Action) -> None:  # noqa: B027 - most drivers refuse nothing more
        """Refuse an action that is valid by itself but not after those before it. Raises ActionError.

        Args:
            action: as its space's ``check`` returned it.
        """

    @abstractmethod
    def apply(self, action: Action, period_s: float) -> Mapping[str, F64]:
        """Make a checked action the controller's command for one period of the policy's control rate.

        Returns:
            Array path of a recording -> the entry that this action adds to it; the same paths for every action.
        """


class CartesianPose(Driver):
    """The impedance's target moves to the pose of each action, no faster than the protocol allows, with the tool's
    compliance if the action has one."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        impedance = simulation.protocol.impedance
        self._stiffness = _per_axis((impedance.translational_n_m, impedance.rotational_nm_rad))
        self._damping_ratio, self._wrench = 1.0, np.zeros(6)
        self.unused = {PER_AXIS, DAMPING, WRENCH}

    def check(self, action: Action) -> None:
        """Raise ActionError for an axis with neither stiffness nor feedforward, because nothing would hold the tool
        there.
        """
        stiffness = self._stiffness if action.stiffness is None else _per_axis(action.stiffness)
        wrench = self._wrench if action.wrench_in_tcp is None else action.wrench_in_tcp
        loose = [axis for axis, k, w in zip(AXES, stiffness, wrench, strict=True) if k == 0 and w == 0]
        if loose:
            raise ActionError(
                f"stiffness: 0 along {', '.join(loose)}, where no feedforward acts either; give wrench_in_tcp a number "
                "other than 0 there, or the axis a stiffness"
            )

    def apply(self, action: Action, period_s: float) -> Mapping[str, F64]:
        before = *self._stiffness, self._damping_ratio
        if action.stiffness is not None:
            self._stiffness = _per_axis(action.stiffness)
            if len(action.stiffness) == len(AXES):
                self.unused.discard(PER_AXIS)
        if action.damping_ratio is not None:
            self._damping_ratio = action.damping_ratio
            self.unused.discard(DAMPING)
        if (*self._stiffness, self._damping_ratio) != before:
            self.simulation.impedance.set_gains(self._stiffness, self._damping_ratio)
        if action.wrench_in_tcp is not None:
            self._wrench = action.wrench_in_tcp
            self.simulation.impedance.feedforward = self._wrench
            self.unused.discard(WRENCH)
        self.simulation.set_goal(action.pose_tcp_in_base, period_s)
        pose = action.pose_tcp_in_base
        return {
            "actions/pose_tcp_in_base": np.full(7, np.nan) if pose is None else pose,
            # Metrics know two numbers: each is that of the stiffest of its three axes.
            "actions/stiffness": np.array([self._stiffness[:3].max(), self._stiffness[3:].max()]),
            PER_AXIS: self._stiffness,
            DAMPING: np.array(self._damping_ratio),
            WRENCH: self._wrench,
        }


def _per_axis(stiffness: tuple[float, ...]) -> npt.NDArray[np.float64]:
    """Expand stiffness (2,), translational and rotational, to one value for each axis (6,); (6,) stays as it is."""
    return np.repeat(stiffness, 3) if len(stiffness) == 2 else np.array(stiffness)


class JointDriver(Driver):
    """Turns the numbers of an action into a joint target that holds until the next action."""

    def apply(self, action: Action, period_s: float) -> Mapping[str, F64]:
        if action.joint is not None:
            self.simulation.set_joint_target(self._target(action.joint))
        joints = len(self.simulation.robot.joints)
        return {
            "actions/pose_tcp_in_base": np.full(7, np.nan),
            "actions/stiffness": np.full(2, np.nan),
            "actions/joint": np.full(joints, np.nan) if action.joint is None else action.joint,
        }

    @abstractmethod
    def _target(self, joint: F64) -> F64:
        """Turn the numbers (joints,) of an action into joint targets (joints,) [rad]."""


class JointPosition(JointDriver):
    def _target(self, joint: F64) -> F64:
        return joint


class DroidJointVelocity(JointDriver):
    """Adds each velocity to the measured angles and not to the last target, so that the target does not run away while
    the robot pushes.
    """

    def _target(self, joint: F64) -> F64:
        measured = self.simulation.encoders.joint_position(self.simulation.data)
        return measured + DROID_STEP_RAD * joint / max(1.0, float(np.abs(joint).max()))


DRIVERS: Mapping[str, type[Driver]] = {
    "cartesian_pose": CartesianPose,
    "joint_position": JointPosition,
    "droid_joint_velocity": DroidJointVelocity,
}
"""Action space of carecontact -> its driver; a space of another package names its own (``ActionSpace.driver``)."""


def driver_of(card: PolicyCard, simulation: Simulation) -> Driver:
    """Return a driver for the card's action space over a simulation that has the card's control."""
    if card.action_space in DRIVERS:
        return DRIVERS[card.action_space](simulation)
    module, _, name = ACTION_SPACES[card.action_space].driver.partition(":")
    if not name:
        raise ConfigError(f"action space {card.action_space!r} names no driver; expected module:Class of a Driver")
    return getattr(import_module(module), name)(simulation)
