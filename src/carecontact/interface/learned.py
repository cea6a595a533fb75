"""What a learned policy sees and answers in numbers: the same in an environment for learning, in a dataset, and in a
policy that sits the exam."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image

from carecontact.errors import ActionError
from carecontact.interface.action import Action
from carecontact.interface.deltas import DELTAS, WIDTH, DeltaConvention
from carecontact.interface.geometry import back_project, matrix_from_quat, vector_from_matrix
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.robot import ActionBounds

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""Orientation (4,) wxyz of a tool that points straight down, with its x axis along that of the base."""
ABSOLUTE_TURN_RAD = np.pi / 2
"""Rotation from DOWN that the number 1 means in an absolute row."""
JOINTS = 7
AGENT_POS = {"position": 3, "rotation": 6, "joints": JOINTS, "velocities": JOINTS, "behind": 6}
"""Parts of ``agent_pos`` and their widths, in their order."""
MOST = np.repeat([2.0, 1.0, 2 * np.pi, 10.0, 2.0, np.pi + 0.01], [3, 6, JOINTS, JOINTS, 3, 3])
"""(29,) largest size of each number of ``agent_pos``; what lies beyond is moved there."""

TRIED = 12
"""Pixels that are drawn for each point: the workspace is more than a tenth of what the overhead camera sees."""


def square(rgb: npt.NDArray[np.uint8] | None, size: int) -> npt.NDArray[np.uint8]:
    """(H, W, 3) -> (size, size, 3): the middle of a picture, each pixel the mean of the area that it covers."""
    assert rgb is not None
    height, width = rgb.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = Image.fromarray(rgb[top : top + side, left : left + side])
    return np.asarray(middle.resize((size, size), Image.Resampling.BOX))


def cloud(view: CameraView, count: int, bounds: ActionBounds, rng: np.random.Generator) -> F32:
    """(count, 6) points of a view inside the workspace: places in base [m] and colours in [0, 1] of random pixels.
    If fewer pixels are inside, some come twice; if none is, all rows are zero."""
    assert view.rgb is not None
    assert view.depth is not None
    v, u = (rng.integers(side, size=TRIED * count) for side in view.depth.shape)
    points = back_project(np.stack([u, v], 1), view.depth[v, u], view.intrinsics, view.pose_camera_in_base)
    inside = ((points >= bounds.workspace_low_m) & (points <= bounds.workspace_high_m)).all(1)
    if not inside.any():
        return np.zeros((count, 6), np.float32)
    found = np.hstack([points, view.rgb[v, u] / 255])[inside]
    return np.resize(found, (max(count, len(found)), 6))[:count].astype(np.float32)


def rotation_6d(matrix: F64) -> F64:
    """Return the first two columns of a rotation (3, 3), one after the other: (6,) (Zhou et al. 2019)."""
    return matrix[:, :2].T.ravel()


class LearnedActions:
    """Turns the rows of one trial into actions and its observations into numbers. It holds the last target, to which a
    row is added and from which the tool lags behind where something resists it."""

    def __init__(self, bounds: ActionBounds, *, absolute: bool = False) -> None:
        """
        Args:
            bounds: those of the session; targets are moved into the workspace.
            absolute: whether rows are targets in the workspace, and not differences in the convention ``learn``.
        """
        self._low, self._high = np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m)
        home = np.concatenate([(self._low + self._high) / 2, DOWN])
        self._convention, self._home = DELTAS["learn"], None
        if absolute:
            unit = (float((self._high - self._low).max()) / 2, ABSOLUTE_TURN_RAD)
            self._convention = DeltaConvention(description="", origin="target", unit=unit, most=(1.0, 1.0))
            self._home = home
        self.target = home
        """(7,) the last target in base, position [m] and quat_wxyz; after ``begin``, the pose of the tool."""

    def begin(self, first: Observation) -> None:
        """Begin a trial with its first observation."""
        self.target = first.pose_tcp_in_base.copy()

    def action(self, row: npt.ArrayLike) -> Action:
        """Return the action that a row (7,) means: three numbers of position, three of rotation, and done where the
        last one is above 0. Numbers beyond -1 and 1, and targets outside the workspace, are moved onto the border.

        An absolute row holds the position from the middle of the workspace, in units of half its longest side, and the
        rotation vector from DOWN along the axes of the base, in units of a quarter turn.

        Raises ActionError for another shape and for what is not finite.
        """
        numbers = np.asarray(row, np.float64)
        if numbers.shape != (WIDTH,) or not np.isfinite(numbers).all():
            raise ActionError(f"action: expected {WIDTH} finite numbers, got {numbers.tolist()!s:.200}")
        convention, origin = self._convention, self.target if self._home is None else self._home
        target = convention.target(convention.clipped(numbers[:6]), measured=origin, last=origin)
        target[:3] = np.clip(target[:3], self._low, self._high)
        self.target = target
        return Action(pose_tcp_in_base=target, done=bool(numbers[6] > 0))

    def agent_pos(self, observation: Observation) -> F32:
        """Return the numbers (29,) of AGENT_POS: position of the tool centre point [m], ``rotation_6d`` of the tool,
        angles [rad] and speeds [rad/s] of the joints, and how far the tool is behind its last target: position [m] and
        rotation vector [rad]. All poses are in base."""
        pose = observation.pose_tcp_in_base
        tool = matrix_from_quat(pose[3:])
        turn = vector_from_matrix(matrix_from_quat(self.target[3:]) @ tool.T)
        parts = pose[:3], rotation_6d(tool), observation.joint_position, observation.joint_velocity
        numbers = np.concatenate([*parts, self.target[:3] - pose[:3], turn])
        return np.clip(numbers, -MOST, MOST).astype(np.float32)


class DatasetRows:
    """Makes ``observation.state`` of a dataset (``carecontact export lerobot --render``) of what a policy sees, and
    actions of rows of ``action``: for the dataset itself, and for a policy that was trained on it."""

    convention = DELTAS["metres-base"]
    """That of ``action.delta``, and of the lag at the end of the state."""

    def begin(self, first: Observation) -> None:
        """Begin a trial with its first observation."""
        self.target = first.pose_tcp_in_base.copy()
        quat = self.target[3:]
        self._quat = quat * np.sign(quat[np.abs(quat).argmax()])

    def state(self, observation: Observation) -> F32:
        """Return the state (27,): pose of the tool in base [m], quat_wxyz, angles [rad] and speeds [rad/s] of the
        joints, and the lag from the tool to its last target, position [m] and rotation vector [rad].

        Of a quaternion and its negative, it has the one with a positive largest number in the first row, and the one
        nearer to the row before in every other.
        """
        pose = observation.pose_tcp_in_base
        self._quat = pose[3:] if pose[3:] @ self._quat >= 0 else -pose[3:]
        lag = self.convention.delta(self.target, measured=pose, last=pose)
        parts = pose[:3], self._quat, observation.joint_position, observation.joint_velocity, lag
        return np.concatenate(parts).astype(np.float32)

    def action(self, row: npt.ArrayLike) -> Action:
        """Return the action that a row (8,) means: position [m] and quat_wxyz of the target in base, and done above
        one half. Raises ActionError for another shape and for what is not finite."""
        numbers = np.asarray(row, np.float64)
        if numbers.shape != (8,) or not np.isfinite(numbers).all() or not numbers[3:7].any():
            raise ActionError(f"action: expected 8 finite numbers and a rotation, got {numbers.tolist()!s:.200}")
        self.target = np.concatenate([numbers[:3], numbers[3:7] / np.linalg.norm(numbers[3:7])])
        return Action(pose_tcp_in_base=self.target, done=bool(numbers[7] > 0.5))
