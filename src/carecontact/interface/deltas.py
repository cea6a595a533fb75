"""Differences of the tool's pose and the absolute targets that they mean: the only conversion between the two, for
actions, environments and exporters.

What a row ``(dx, dy, dz, three numbers of rotation, gripper)`` means differs from project to project. A row of DELTAS
names a convention, and a card of the action space ``cartesian_delta`` names such a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError
from carecontact.interface.action import Action
from carecontact.interface.geometry import (
    euler_xyz_from_matrix,
    matrix_from_euler_xyz,
    matrix_from_quat,
    matrix_from_vector,
    quat_from_matrix,
    vector_from_matrix,
)
from carecontact.registry import Registry

F64 = npt.NDArray[np.float64]

DELTA_SPACE = "cartesian_delta"
"""The action space whose cards name a convention."""
DEFAULT_DELTAS = "osc"
"""The convention of a card that names none."""
WIDTH = 7
"""Three numbers of position, three of rotation, and the gripper."""
NO_TURN = 1e-8
"""Rotations whose numbers are all smaller count as none, as in robosuite (``np.isclose`` in its OSC)."""


@dataclass(frozen=True, kw_only=True)
class DeltaConvention:
    """What the numbers of a delta mean: frame, origin, scale, form of the rotation, and polarity of the gripper."""

    description: str
    frame: Literal["base", "tool"] = "base"
    """Whose axes the translation and the rotation have. The rotation turns the tool about the tool centre point."""
    origin: Literal["measured", "target"] = "measured"
    """What a delta is added to: the pose that the robot measures when the action begins, or its last target. From the
    measured pose, an action without rotation keeps the orientation of the last target, as in robosuite."""
    unit: tuple[float, float] = (1.0, 1.0)
    """Translation [m] and rotation [rad] of the number 1."""
    most: tuple[float, float]
    """Largest number of each component of the translation and of the rotation."""
    rotation: Literal["vector", "euler_xyz"] = "vector"
    """Rotation vector, or angles about the fixed axes x, y and z, applied in this order."""
    gripper: tuple[float, float] = (0.0, 1.0)
    """Numbers of a closed and of an open gripper."""

    @property
    def bounds(self) -> F64:
        """(6,) largest number of each component."""
        return np.repeat(self.most, 3)

    def clipped(self, delta: F64) -> F64:
        """Move numbers (..., 6) beyond the bounds onto them."""
        return np.clip(delta, -self.bounds, self.bounds)

    def target(self, delta: F64, *, measured: F64, last: F64) -> F64:
        """Return the target (7,), position [m] and quat_wxyz in base, that the numbers (6,) mean.

        Args:
            measured: (7,) measured pose of the tool in base.
            last: (7,) the last target.
        """
        numbers = np.asarray(delta, np.float64)
        origin, turned = (last if self.origin == "target" else measured), (np.abs(numbers[3:]) > NO_TURN).any()
        start = matrix_from_quat((origin if turned else last)[3:])
        shift, turn = self.unit[0] * numbers[:3], self._matrix(self.unit[1] * numbers[3:])
        if self.frame == "tool":
            shift, end = matrix_from_quat(origin[3:]) @ shift, start @ turn
        else:
            end = turn @ start
        return np.concatenate([origin[:3] + shift, quat_from_matrix(end) if turned else last[3:]])

    def delta(self, pose: F64, *, measured: F64, last: F64) -> F64:
        """Return the numbers (6,) whose ``target`` is a pose (7,); they may lie beyond the bounds.

        The inverse of ``target``, except for a pose that has the measured orientation while the last target has
        another: no numbers mean this pose.
        """
        origin = last if self.origin == "target" else measured
        start, end = matrix_from_quat(origin[3:]), matrix_from_quat(pose[3:])
        shift, turn = pose[:3] - origin[:3], end @ start.T
        if self.frame == "tool":
            shift, turn = start.T @ shift, start.T @ end
        kept = np.allclose(end, matrix_from_quat(last[3:]), rtol=0, atol=NO_TURN)
        angles = np.zeros(3) if kept else self._angles(turn)
        return np.concatenate([shift / self.unit[0], angles / self.unit[1]])

    def action(self, row: npt.ArrayLike) -> Action:
        """Return the action that a row (7,) means, with the numbers moved into their bounds, as robosuite and Bridge's
        robots do. Raises ActionError for another shape and for what is not finite."""
        numbers = np.asarray(row, np.float64)
        if numbers.shape != (WIDTH,) or not np.isfinite(numbers).all():
            raise ActionError(f"delta: expected {WIDTH} finite numbers, got {numbers.tolist()!s:.200}")
        return Action(delta=self.clipped(numbers[:6]), gripper=float(np.clip(self.opening(numbers[6]), 0.0, 1.0)))

    def row(self, pose: F64, opening: float, *, measured: F64, last: F64) -> F64:
        """Return the row (7,) for a target (7,) and an opening of the gripper in [0, 1], moved into the bounds."""
        closed, opened = self.gripper
        numbers = self.clipped(self.delta(pose, measured=measured, last=last))
        return np.append(numbers, closed + opening * (opened - closed))

    def opening(self, gripper: npt.ArrayLike) -> F64:
        """Turn numbers (...) of the gripper into its opening, 0 closed and 1 open."""
        closed, opened = self.gripper
        return (np.asarray(gripper, np.float64) - closed) / (opened - closed)

    def _matrix(self, angles: F64) -> F64:
        return matrix_from_vector(angles) if self.rotation == "vector" else matrix_from_euler_xyz(angles)

    def _angles(self, matrix: F64) -> F64:
        return vector_from_matrix(matrix) if self.rotation == "vector" else euler_xyz_from_matrix(matrix)


DELTAS: Registry[DeltaConvention] = Registry("delta convention", row=DeltaConvention, plural="delta_conventions")

# ARISE-Initiative/robosuite 03f55e5f: controllers/config/osc_pose.json has the scales and the bounds,
# controllers/osc.py adds to the measured position and turns the measured orientation about the world's axes. LIBERO
# (Lifelong-Robot-Learning/LIBERO 4f0dd188, libero/libero/envs/env_wrapper.py) uses this controller at 20 Hz, and there
# the axes of the world are those of the base. The gripper: robosuite 022f723f, the gripper's format_action, where -1
# opens and 1 closes.
DELTAS.register(
    "osc",
    DeltaConvention(
        description="LIBERO and robosuite's OSC_POSE: 1 is 50 mm and 0.5 rad, added to the measured pose.",
        unit=(0.05, 0.5),
        most=(1.0, 1.0),
        gripper=(1.0, -1.0),
    ),
)
# rail-berkeley/bridge_data_robot 07d656fa, widowx_envs/widowx_envs/base/robot_base_env.py: action_space has the bounds,
# _next_qpos adds to the last target, turned by Euler angles about the axes of the base. simpler-env/SimplerEnv
# 34d9ccfa, simpler_env/policies/octo/octo_model.py, reads the angles in the same way; 1 opens the gripper there, too.
DELTAS.register(
    "bridge",
    DeltaConvention(
        description="Bridge's robots and SimplerEnv: metres and Euler angles in base, added to the last target.",
        origin="target",
        most=(0.05, 0.25),
        rotation="euler_xyz",
    ),
)
DELTAS.register(
    "learn",
    DeltaConvention(
        description="The environments for learning: 1 is 25 mm and 0.1 rad, added to the last target.",
        origin="target",
        # At 10 Hz, as fast as a target moves: 0.25 m/s and 1 rad/s.
        unit=(0.025, 0.1),
        most=(1.0, 1.0),
    ),
)
for _frame in ("base", "tool"):
    DELTAS.register(
        f"metres-{_frame}",
        DeltaConvention(
            description=f"Metres and a rotation vector [rad] along the axes of the {_frame}, added to the last target.",
            frame=_frame,
            origin="target",
            # As far as a target moves in about one second.
            most=(0.25, 1.0),
        ),
    )
