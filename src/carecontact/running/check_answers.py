"""The numbers and pictures of an answer, column by column, beside what they should be."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from carecontact.errors import ConfigError
from carecontact.interface.action import Action
from carecontact.running.trial import CheckFinding

# Looks at the numbers of an answer, column by column, and compares them with what they should be.

F64 = npt.NDArray[np.float64]

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
NEARER = 0.5
"""Numbers look like targets if they are nearer to the joint angles than to zero by this factor, and the reverse."""
NORMALISED = 1.2
"""Largest plausible normalised velocity: the output of a network exceeds [-1, 1] a little; larger numbers are no
velocity."""
TURN_RAD = 2 * np.pi
GRIPPER_OVERSHOOT = 0.1
OPEN, CLOSED = 0.25, 0.75
"""Below the first value a gripper command means open, above the second closed, in the convention of DROID's data."""


def numbers_of(actions: Sequence[Action]) -> F64:
    """Return all numbers (steps, columns) of actions, field by field; a missing number is 0."""
    rows = [np.concatenate([_numbers(getattr(action, field.name)) for field in fields(Action)]) for action in actions]
    width = max(map(len, rows))
    return np.array([np.pad(row, (0, width - len(row))) for row in rows])


def joints_of(actions: Sequence[Action]) -> F64 | None:
    """Return the joint values (steps, joints) of actions; None if an action has none."""
    given = [action.joint for action in actions]
    return None if any(joint is None for joint in given) else np.array(given, np.float64)


def table(values: F64, *, now: F64, kind: str) -> list[str]:
    """Return one line for each column: its range, and for joints their present angle [rad].

    Args:
        values: (steps, columns).
        now: (joints,) present joint angles [rad].
        kind: ``joints``, or ``poses`` for poses of the tool.
    """
    lines: list[str] = []
    for i, column in enumerate(values.T):
        known = column[np.isfinite(column)]
        span = f"{known.min():9.3f} to {known.max():9.3f}" if known.size else "no number"
        wrong = f"; {column.size - known.size} of {column.size} are not finite" if known.size < column.size else ""
        angle = f"; the angle is {now[i]:.3f} rad" if kind == "joints" and i < len(now) else ""
        lines.append(f"{_name(i, kind, len(now)):16}{span}{angle}{wrong}")
    return lines


def look_at_joints(joints: F64, *, space: str, now: F64) -> Iterator[CheckFinding]:
    """Yield warnings about finite joint commands (steps, joints) of an action space; ``now``: the angles [rad]."""
    largest = float(np.abs(joints).max())
    from_now, from_zero = float(np.sqrt(((joints - now) ** 2).mean())), float(np.sqrt((joints**2).mean()))
    near = f"the actions differ from the joint angles by {from_now:.2f} and from zero by {from_zero:.2f} on average"
    if space == "droid_joint_velocity":
        if largest > TURN_RAD:
            yield _warning(
                "degrees",
                f"velocities of up to {largest:.0f}: these look like degrees; send velocities that are normalised to "
                "[-1, 1]",
            )
        elif from_now < NEARER * from_zero:
            yield _warning(
                "velocities",
                f"{near}: they look like targets, but the action space is velocities: checkpoint, profile or space is "
                "the wrong one",
            )
        elif largest > NORMALISED:
            share = float((np.abs(joints) > 1).mean())
            yield _warning(
                "velocities",
                f"{share:.0%} of the velocities lie beyond [-1, 1], up to {largest:.2f}, and are clipped: send "
                "normalised velocities, not rad/s",
            )
    elif space == "joint_position":
        if largest > TURN_RAD:
            yield _warning("degrees", f"targets of up to {largest:.0f}: these look like degrees; send radians")
        elif from_zero < NEARER * from_now and largest <= NORMALISED:
            yield _warning(
                "targets",
                f"{near}: they look like velocities or differences, but the action space is joint angles: checkpoint, "
                "profile or space is the wrong one, or the server has to add the angles",
            )


def look_at_gripper(commands: F64) -> Iterator[CheckFinding]:
    """Yield findings about the last column (steps,), where 0 should be open and 1 closed."""
    low, high = float(commands.min()), float(commands.max())
    if low < -GRIPPER_OVERSHOOT or high > 1 + GRIPPER_OVERSHOOT:
        text = (
            f"the gripper's column goes from {low:.2f} to {high:.2f}, expected 0 (open) to 1 (closed); it is ignored, "
            "but its place or its convention is another one"
        )
        yield _warning("gripper", text)
    elif high < OPEN:
        text = (
            "the server is told that the gripper is closed (1) and commands an open one (0) in every step. It is "
            "ignored; if the server means a closed one, its polarity is the opposite of DROID's"
        )
        yield CheckFinding(level="hint", topic="gripper", text=text)


def look_at_polarity(told_closed: F64, told_open: F64) -> Iterator[CheckFinding]:
    """Yield a warning if the commands follow the opposite convention to that in which the server is told the gripper's
    state.

    ``told_closed``, ``told_open``: the commands after the server was told that the gripper is closed, and open.
    """
    if told_closed.mean() < OPEN and told_open.mean() > CLOSED:
        text = (
            "told that the gripper is closed (1), the server commands an open one (0), and the reverse: its polarity "
            "looks like the opposite of DROID's, where 1 is closed"
        )
        yield _warning("gripper", text)


def _warning(topic: str, text: str) -> CheckFinding:
    return CheckFinding(level="warning", topic=topic, text=text)


def _name(column: int, kind: str, joints: int) -> str:
    if kind == "poses":
        return POSE[column]
    known = [*(f"joint {i + 1}" for i in range(joints)), "gripper"]
    return known[column] if column < len(known) else f"column {column + 1}, unknown"


def _numbers(value: object) -> F64:
    return np.zeros(1) if value is None else np.ravel(np.asarray(value, np.float64))


# Draws the pictures of one request on a sheet, pixel for pixel as they are sent.

U8 = npt.NDArray[np.uint8]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

MARGIN_PX, LINE_PX, TEXT_PX, ROW_PX = 16, 18, 14, 1400
PAPER, INK, FRAME = (255, 255, 255), (31, 42, 54), (220, 0, 160)
"""Colours of the sheet. The frame lies around the pixels of a picture and covers none."""


def check_sheet_path(path: Path) -> Path:
    """Return the path. Raises ConfigError for a file format that would lose detail and for a folder that does not
    exist.
    """
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--pictures {path}: expected a name that ends in .png, which keeps every pixel")
    if not path.resolve().parent.is_dir():
        raise ConfigError(f"--pictures {path}: there is no folder {path.parent}")
    return path


def save_sheet(pictures: Mapping[str, U8], path: Path, *, names: Mapping[str, str], title: str) -> None:
    """Write all pictures beside each other, each at its own size and under its key.

    Args:
        pictures: key -> (H, W, 3) red green blue.
        names: key -> name of our camera, where it is known.

    Raises:
        ConfigError: the file cannot be written.
    """
    font = ImageFont.load_default(size=TEXT_PX)
    labels = {
        key: (key, f"{f'camera {names[key]}, ' if key in names else ''}{image.shape[1]} x {image.shape[0]} pixels")
        for key, image in pictures.items()
    }
    place, (width, height) = _places(pictures, labels, title, font)
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN_PX, MARGIN_PX), title, INK, font)
    for key, (x, y) in place.items():
        for i, line in enumerate(labels[key]):
            draw.text((x, y + i * LINE_PX), line, INK, font)
        top, (high, wide) = y + 2 * LINE_PX + 2, pictures[key].shape[:2]
        draw.rectangle((x - 1, top - 1, x + wide, top + high), outline=FRAME)
        sheet.paste(Image.fromarray(np.ascontiguousarray(pictures[key])), (x, top))
    try:
        sheet.save(path)
    except OSError as error:
        raise ConfigError(f"--pictures {path}: {error.strerror or error}") from None


def _places(
    pictures: Mapping[str, U8], labels: Mapping[str, tuple[str, str]], title: str, font: Font
) -> tuple[dict[str, tuple[int, int]], tuple[int, int]]:
    """Return key -> top left corner of its label, row after row, and the width and height of the sheet [px]."""
    x, y, row_px, place = MARGIN_PX, 2 * MARGIN_PX + LINE_PX, 0, {}
    width = int(font.getlength(title)) + 2 * MARGIN_PX
    for key, image in pictures.items():
        wide = max(image.shape[1], *(int(font.getlength(line)) for line in labels[key]))
        if x > MARGIN_PX and x + wide + MARGIN_PX > ROW_PX:
            x, y, row_px = MARGIN_PX, y + row_px + MARGIN_PX, 0
        place[key] = (x, y)
        x, row_px = x + wide + MARGIN_PX, max(row_px, image.shape[0] + 2 * LINE_PX + 4)
        width = max(width, x)
    return place, (width, y + row_px + MARGIN_PX)
