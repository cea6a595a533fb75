"""What openpi's and vla-eval's dialects share: pictures as their clients resize them, and chunks of actions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image

from carecontact.errors import ActionError, ObservationError
from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.deltas import WIDTH as DELTA_WIDTH
from carecontact.interface.deltas import DeltaConvention
from carecontact.interface.observation import U8, Observation
from carecontact.serving.cartesian import ORIENTATIONS, Setup
from carecontact.serving.packing import is_array

CAPTURED_HW = (288, 512)
"""Height and width [px] to which RoboArena's client first resizes every captured picture."""
JOINTS = 7
WIDTH = JOINTS + 1
"""Seven joints and the gripper."""
GRIPPER_SLACK = 0.5
"""How far a gripper command may lie outside 0 to 1. The output of a network exceeds this range by some hundredths; the
other conventions, -1 to 1 and 0 to 255, exceed it by more than this."""


def picture_of(observation: Observation, camera: str, *, aspect: tuple[int, int] = (16, 9)) -> U8:
    """Return a camera's picture (H, W, 3), cut to the aspect. Raises ObservationError if there is none."""
    view = observation.cameras.get(camera)
    if view is None or view.rgb is None:
        raise ObservationError(f"observation.cameras.{camera}.rgb: expected a picture, got none")
    return cropped(view.rgb, aspect)


def cropped(image: U8, aspect: tuple[int, int]) -> U8:
    """Cut an (H, W, 3) picture to an aspect, width to height, about its centre; one that has it stays as it is. DROID's
    cameras have 16:9."""
    (height, width), (across, down) = image.shape[:2], aspect
    high, wide = min(height, width * down // across), min(width, height * across // down)
    top, left = (height - high) // 2, (width - wide) // 2
    return image[top : top + high, left : left + wide]


def setup_picture(observation: Observation, camera: str, setup: Setup, *, orientation: str, hw: tuple[int, int]) -> U8:
    """Return a camera's picture as a benchmark shows it: cut, turned, and resized without regard to its shape."""
    image = ORIENTATIONS[orientation](picture_of(observation, camera, aspect=setup.aspect))
    return _resized(image, hw, Image.Resampling.LANCZOS if setup.lanczos else Image.Resampling.BILINEAR)


def padded(image: U8, hw: tuple[int, int]) -> U8:
    """Resize an (H, W, 3) picture without distortion and centre it on black: openpi's ``resize_with_pad``.

    It must be PIL's bilinear filter, which averages over the pixels that it leaves out and OpenCV's does not, with
    sizes rounded down: both choices affect every pixel.
    """
    height, width = hw
    if image.shape[:2] == hw:
        return image
    ratio = max(image.shape[1] / width, image.shape[0] / height)
    high, wide = int(image.shape[0] / ratio), int(image.shape[1] / ratio)
    out = np.zeros((height, width, 3), np.uint8)
    top, left = int((height - high) / 2), int((width - wide) / 2)
    out[top : top + high, left : left + wide] = _resized(image, (high, wide), Image.Resampling.BILINEAR)
    return out


def stretched(image: U8, hw: tuple[int, int] | None) -> U8:
    """Resize an (H, W, 3) picture to the captured size and then to ``hw`` without regard to its shape, as RoboArena
    does.

    ``hw``: None for a server that takes pictures as they were captured.
    """
    captured = _resized(image, CAPTURED_HW, Image.Resampling.LANCZOS)
    return captured if hw is None or hw == CAPTURED_HW else _resized(captured, hw, Image.Resampling.LANCZOS)


def _resized(image: U8, hw: tuple[int, int], method: Image.Resampling) -> U8:
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((hw[1], hw[0]), resample=method))


def joint_actions(chunk: object, *, horizon: int | None, space: str, grips: bool = True) -> list[Action]:
    """Return the actions to execute, in the order of the chunk.

    Args:
        chunk: (N, 8) numbers: seven joints and a gripper command, which is checked and ignored, since the hand is
            closed.
        horizon: number of actions that are executed; None executes all.
        grips: whether the gripper command has to be 0 (open) to 1 (closed).
        space: the action space. Velocities are clipped to [-1, 1], as the clients of openpi and RoboArena do.

    Raises ActionError if the chunk is not such an array; the message says what was expected and what may help.
    """
    values = _rows(chunk, f"{JOINTS} joints and the gripper", width=WIDTH, horizon=horizon)
    if grips:
        _check_grip(values[:, -1], "0 (open) to 1 (closed)", opening=1 - values[:, -1])
    joints: npt.NDArray[np.float64] = values[:horizon, :JOINTS]
    if space == "droid_joint_velocity":
        return [Action(joint=row) for row in np.clip(joints, -1.0, 1.0)]
    if (far := np.abs(joints).max()) > 2 * np.pi:
        raise ActionError(f"actions: expected joint angles in radians, got {far:g}: the server answers in degrees?")
    return [Action(joint=row) for row in joints]


def delta_actions(
    chunk: object, *, horizon: int | None, convention: DeltaConvention, grips: bool = True
) -> list[Action]:
    """Return the same for rows (N, 7) of a convention. Numbers beyond its bounds are moved onto them, as robosuite and
    Bridge's robots do; the gripper command is checked and ignored.

    Raises ActionError as ``joint_actions`` does.
    """
    columns = "three of translation, three of rotation and the gripper"
    values = _rows(chunk, columns, width=DELTA_WIDTH, horizon=horizon)
    if grips:
        (closed, opened), commands = convention.gripper, values[:, -1]
        _check_grip(commands, f"{opened:g} (open) to {closed:g} (closed)", opening=convention.opening(commands))
    return [Action(delta=row) for row in convention.clipped(values[:horizon, :-1])]


def _rows(chunk: object, columns: str, *, width: int, horizon: int | None) -> npt.NDArray[np.float64]:
    """Return a chunk as numbers (N, width), the gripper's command last."""
    expected = f"actions: expected an array of numbers (steps, {width}): {columns}"
    if not is_array(chunk):
        raise ActionError(f"{expected}, got {type(chunk).__name__} {chunk!r:.80}")
    if chunk.dtype.kind not in "fiu" or chunk.ndim != 2 or chunk.shape[1] != width or not 1 <= len(chunk) <= MAX_CHUNK:
        hint = ""
        if chunk.shape[-1:] == (width - 1,):
            hint = ": the gripper's column is missing"
        elif chunk.shape[-1:] > (width,):
            hint = f": columns from number {width + 1} on have no meaning here"
        raise ActionError(f"{expected}, 1 to {MAX_CHUNK} steps, got {chunk.dtype} {chunk.shape}{hint}")
    # Converting a NaN to another width may raise a floating-point warning; the check below names the NaN.
    with np.errstate(invalid="ignore"):
        values = chunk.astype(np.float64)
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0].tolist()
        raise ActionError(f"actions[{row}]: expected finite numbers, got {values[row, column]} in column {column + 1}")
    if horizon is not None and len(values) < horizon:
        raise ActionError(
            f"actions: expected at least {horizon} steps, the horizon, got {len(values)}; add horizon={len(values)} "
            "to the address"
        )
    return values


def _check_grip(commands: npt.NDArray[np.float64], expected: str, *, opening: npt.NDArray[np.float64]) -> None:
    """Raise ActionError for gripper commands (N,) of another convention, by the openings (N,) that they would mean."""
    outside = np.flatnonzero((opening < -GRIPPER_SLACK) | (opening > 1 + GRIPPER_SLACK))
    if len(outside):
        raise ActionError(
            f"actions[{outside[0]}]: expected a gripper command of {expected} in the last column, got "
            f"{commands[outside[0]]:g}: the server has another convention, or its columns are in another order"
        )
