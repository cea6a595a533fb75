"""How a checked action becomes a command of the controller, for each action space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError, ConfigError
from carecontact.interface.action import ACTION_SPACES, Action
from carecontact.interface.deltas import DELTAS
from carecontact.interface.geometry import quat_from_matrix
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.sections import DAMPING_RATIO
from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]

AXES = ("x", "y", "z", "about x", "about y", "about z")
PER_AXIS, DAMPING, WRENCH = "actions/axis_stiffness", "actions/damping_ratio", "actions/wrench_in_tcp"
DROID_STEP_RAD = 0.2
"""Change of the target [rad] in one control period at a normalised velocity of 1 (``relative_max_joint_delta`` in
DROID's droid/robot_ik/robot_ik_solver.py)."""


class Driver(ABC):
    """Drives the controller of one simulation with the actions of one policy."""

    card: PolicyCard
    """The policy's, which ``driver_of`` sets."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.clipped = False
        """Whether the last ``apply`` moved its target onto a border."""
        self.unused: set[str] = set()
        """The paths of ``apply`` that no action has used so far, which the recording leaves out."""

    def clip(self, action: Action) -> Action:
        """Move an action into bounds that its space alone does not know; the same object if nothing has to be moved."""
        return action

    def check(self, action: Action) -> None:  # noqa: B027 - most drivers refuse nothing more
        """Raise ActionError for an action, checked by its space, that is not valid after those before it."""

    @abstractmethod
    def apply(self, action: Action, period_s: float) -> Mapping[str, F64]:
        """Command a checked action for one control period; return its entry for each array, with the same paths every
        time."""


class CartesianPose(Driver):
    """The impedance's target moves to each pose, no faster than the protocol allows, with the action's compliance."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        impedance = simulation.protocol.impedance
        self._stiffness = _per_axis((impedance.translational_n_m, impedance.rotational_nm_rad))
        self._damping_ratio, self._wrench = DAMPING_RATIO, np.zeros(6)
        self.unused = {PER_AXIS, DAMPING, WRENCH}

    def check(self, action: Action) -> None:
        """Raise ActionError for an axis with neither stiffness nor feedforward: nothing would hold the tool there."""
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


class CartesianDelta(CartesianPose):
    """Adds each delta to the measured pose or to the last target, as the card's convention says, and moves the
    impedance's target there.

    A target outside the workspace is an error unless the card requests ``clip``. Where the protocol has a latency, the
    tool moves on between check and execution; a target that leaves the workspace only then is moved onto its border.
    """

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        self._last: F64 | None = None

    def clip(self, action: Action) -> Action:
        delta = None if action.delta is None else np.asarray(action.delta)
        if delta is None or delta.shape != (6,) or delta.dtype.kind not in "fiu" or not np.isfinite(delta).all():
            return action
        inside = DELTAS[self.card.delta].clipped(delta.astype(np.float64))
        return action if (inside == delta).all() else replace(action, delta=inside)

    def check(self, action: Action) -> None:
        """Raise ActionError for a number beyond the convention's bounds and a target outside the workspace."""
        super().check(action)
        if action.delta is None:
            return
        convention = DELTAS[self.card.delta]
        beyond = np.flatnonzero(np.abs(action.delta) > convention.bounds)
        if len(beyond):
            axis, most = beyond[0], convention.bounds[beyond[0]]
            raise ActionError(
                f"delta: expected {-most:g} to {most:g} {AXES[axis]} in the convention {self.card.delta}, got "
                f"{action.delta[axis]:.6g}; {convention.description}"
            )
        target = self._target(action.delta)
        if self.card.out_of_bounds != "clip" and (self._inside(target) != target).any():
            bounds = self.simulation.protocol.impedance.action_bounds
            raise ActionError(
                f"delta: expected a target inside the workspace {list(bounds.workspace_low_m)} to "
                f"{list(bounds.workspace_high_m)} m in base, got {np.round(target[:3], 6).tolist()}"
            )

    def apply(self, action: Action, period_s: float) -> Mapping[str, F64]:
        """A recorded action has the pose that was made of its delta, and is executed as such."""
        delta, self.clipped = action.delta, False
        if delta is not None:
            target = self._target(delta)
            inside = self._inside(target)
            self.clipped = bool((inside != target).any())
            action = replace(action, delta=None, pose_tcp_in_base=inside)
        if action.pose_tcp_in_base is not None:
            self._last = action.pose_tcp_in_base
        return {**super().apply(action, period_s), "actions/delta": np.full(6, np.nan) if delta is None else delta}

    def _target(self, delta: F64) -> F64:
        """Turn the numbers (6,) of an action into the target (7,) in base."""
        simulation = self.simulation
        # Poses are those at the beginning of the last physics step, unless an observation has brought them up to date.
        simulation.refresh()
        pose = simulation.encoders.pose_tcp_in_base(simulation.data)
        measured = np.concatenate([pose[:3, 3], quat_from_matrix(pose[:3, :3])])
        last = simulation.control.target_in_base if self._last is None else self._last
        return DELTAS[self.card.delta].target(delta, measured=measured, last=last)

    def _inside(self, pose: F64) -> F64:
        bounds = self.simulation.protocol.impedance.action_bounds
        return np.concatenate([np.clip(pose[:3], bounds.workspace_low_m, bounds.workspace_high_m), pose[3:]])


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
    """Adds velocities to the measured angles, so that the target does not run away while the robot pushes."""

    def _target(self, joint: F64) -> F64:
        measured = self.simulation.encoders.joint_position(self.simulation.data)
        return measured + DROID_STEP_RAD * joint / max(1.0, float(np.abs(joint).max()))


DRIVERS: Mapping[str, type[Driver]] = {
    "cartesian_pose": CartesianPose,
    "cartesian_delta": CartesianDelta,
    "joint_position": JointPosition,
    "droid_joint_velocity": DroidJointVelocity,
}
"""Action space of carecontact -> its driver; a space of another package names its own (``ActionSpace.driver``)."""


def driver_of(card: PolicyCard, simulation: Simulation) -> Driver:
    """Return a driver for the card's action space over a simulation that has the card's control."""
    kind = DRIVERS.get(card.action_space)
    if kind is None:
        module, _, name = ACTION_SPACES[card.action_space].driver.partition(":")
        if not name:
            raise ConfigError(f"action space {card.action_space!r} names no driver; expected module:Class of a Driver")
        kind = getattr(import_module(module), name)
    driver: Driver = kind(simulation)
    driver.card = card
    return driver
