"""What a policy may answer: an action, the spaces that say which of its fields it may give, and hints for frequent
mistakes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError
from carecontact.interface.robot import Session
from carecontact.registry import Registry

MAX_CHUNK = 2000
"""Largest number of actions in one answer (a chunk)."""
NEAR_BASE_M = 0.12
"""The robot's base stands there: no tool can be so near, but every difference of two poses is."""
EVERY_SPACE = ("gripper", "done", "look")
"""Fields of an action that belong to no space."""


@dataclass(frozen=True, kw_only=True)
class Action:
    """One action of a chunk. The action space on the policy's card says which fields it may give."""

    pose_tcp_in_base: npt.NDArray[np.float64] | None = None
    """(7,) target of the tool centre point in the robot's base frame, position [m] and quat_wxyz; None keeps the last
    target."""
    stiffness: tuple[float, ...] | None = None
    """(translational [N/m], rotational [N m/rad]), or six numbers: x y z [N/m], then about x y z [N m/rad], along the
    axes of the target. None keeps the last. Out of bounds is an error, never clamped."""
    damping_ratio: float | None = None
    """Damping of every axis as a share of critical damping; None keeps the last, which is 1 at first."""
    wrench_in_tcp: npt.NDArray[np.float64] | None = None
    """(6,) feedforward in the axes of the tool, force [N] and torque [N m], that the robot adds to the spring's wrench
    and exerts on what it touches; None keeps the last, which is zero at first."""
    delta: npt.NDArray[np.float64] | None = None
    """(6,) translation and rotation for ``cartesian_delta``, in the numbers of the card's convention
    (``interface.deltas``); None keeps the last target."""
    joint: npt.NDArray[np.float64] | None = None
    """(joints,) for the joint action spaces: angles [rad] or normalised velocities; None keeps the last target."""
    gripper: float | None = None
    """Opening in [0, 1]; None keeps the last. The closed-gripper embodiment ignores the value, but a value
    outside [0, 1] is still an error."""
    look: tuple[str, ...] = ()
    """Cameras of the card that take a view for the next observation, although their rate (``PolicyCard.camera_hz``)
    does not require one; in a chunk, those that any of its actions names."""
    done: bool = False
    """True ends the trial after this action."""


# Hints about refused actions: what their numbers look like, and what to send instead. A hint is empty if the numbers
# resemble no known mistake.


def pose_shape_hint(shape: tuple[int, ...]) -> str:
    """Return a clause, with its semicolon, about numbers of a shape other than (7,) in place of one pose."""
    if shape == (6,):
        return "; six numbers look like x y z and roll pitch yaw: turn the angles into a quaternion w x y z"
    if shape == (3,):
        return "; three numbers look like a position: add the quaternion w x y z"
    if shape == (8,):
        return "; eight numbers look like a pose and a gripper: give the last one as gripper"
    if shape == (1, 7):
        return "; this looks like a pose in a list of its own: leave the outer list out"
    if len(shape) == 2 and shape[1] == 7:
        return f"; these look like {shape[0]} poses: send a list with one action for each"
    return ""


def looks_like_difference(position: npt.NDArray[np.float64]) -> str:
    """Hint for a position (3,) [m] that is too near the robot's base to be a target."""
    near = math.hypot(*position) < NEAR_BASE_M
    return "looks like a difference to the tool's pose: send the absolute pose of the tool in base" if near else ""


def looks_like_millimetres(
    position: npt.NDArray[np.float64], low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]
) -> str:
    """Hint for a position (3,) that lies in the workspace if its numbers are millimetres. The corners of the workspace
    in base are ``low`` and ``high`` (3,) [m]."""
    metres = position / 1000.0
    if looks_like_difference(metres) or (metres < low).any() or (metres > high).any():
        return ""
    return "looks like millimetres: send metres"


def check_gripper(opening: float | None) -> float | None:
    """Raises ActionError for an opening outside [0, 1]."""
    if opening is None or 0 <= opening <= 1:
        return opening
    hint = "; 1 is open and 0 is closed"
    if -1 <= opening < 0:
        hint += ": of a range from -1 to 1 send (1 + g) / 2, or (1 - g) / 2 where -1 means open"
    raise ActionError(f"gripper: expected an opening in [0, 1], got {opening}{hint}")


@dataclass(frozen=True, kw_only=True)
class ActionSpace:
    """A row of ACTION_SPACES. The registered name is what a policy's card gives as ``action_space``."""

    description: str
    fields: tuple[str, ...]
    """Fields of ``Action`` that belong to this space, besides EVERY_SPACE; the others must be None."""
    in_joints: bool
    """Whether the actions are commands of a joint controller, which the card then has to name as its ``control``."""
    checked: Callable[[Action, Session], Action]
    """The action in normal form; raises ActionError naming the field, what was expected and what was got."""
    clipped: Callable[[Action, Session], Action]
    """The action moved into the bounds; the same object where nothing is outside, or where ``checked`` refuses it."""
    driver: str = ""
    """``module:Class`` of the ``episode.drivers.Driver`` that turns checked actions into commands; empty for the spaces
    of ``episode.drivers.DRIVERS``."""

    def check(self, action: Action, session: Session) -> Action:
        """Return the action in normal form. Raises ActionError naming the field, what was expected and what was got."""
        for name in (field.name for field in fields(Action)):
            if name not in (*self.fields, *EVERY_SPACE) and getattr(action, name) is not None:
                raise ActionError(
                    f"{name}: this field is not one of the card's action space; give {', '.join(self.fields)}, or "
                    "another action_space on the card"
                )
        return self.checked(action, session)

    def clip(self, action: Action, session: Session) -> Action:
        """Return the action moved into the bounds, for a card whose ``out_of_bounds`` is ``clip``; the same object if
        nothing has to be moved."""
        return self.clipped(action, session)


ACTION_SPACES: Registry[ActionSpace] = Registry(
    "action space", row=ActionSpace, plural="action_spaces", scan="carecontact.interface.action_spaces"
)
