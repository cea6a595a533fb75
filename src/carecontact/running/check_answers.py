"""What the numbers of an answer reveal about common mistakes: differences, degrees, quaternion order, polarity.

None of these breaks the contract, so a trial would run and fail for a reason that no score names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from carecontact.interface.action import NEAR_BASE_M, Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import F64, Observation

Level = Literal["ok", "warning", "error", "hint", "wait"]

FAR_M = 0.25
"""Distance of a first target from the tool that counts as far: a second of the fastest motion."""
WRONG_TURN_DEG, RIGHT_TURN_DEG = 90.0, 45.0
"""A first target that turns the tool by more, and by less if its quaternion is read as x y z w, has the other order."""
HALF_OPEN = 0.5
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
DELTA = ("dx", "dy", "dz", "about x", "about y", "about z", "gripper")
NEARER = 0.5
"""Numbers look like targets if they are nearer to the joint angles than to zero by this factor, and the reverse."""
NORMALISED = 1.2
"""Largest plausible normalised velocity: the output of a network exceeds [-1, 1] a little; larger numbers are no
velocity."""
TURN_RAD = 2 * np.pi
GRIPPER_OVERSHOOT = 0.1
OPEN, CLOSED = 0.25, 0.75
"""Below the first value a gripper command means open, above the second closed, in the convention of DROID's data."""


@dataclass(frozen=True)
class CheckFinding:
    level: Level
    topic: str
    text: str
    """Text, whose first line stands beside level and topic, and whose other lines stand below it."""


def look_at(actions: Sequence[Action], observation: Observation) -> Iterator[CheckFinding]:
    """Yield warnings about an answer. A pose that the trial will refuse gives none: the refusal says more."""
    opened = [action.gripper for action in actions if action.gripper is not None and action.gripper > HALF_OPEN]
    reads = float(observation.gripper_position[0])
    if opened and reads < HALF_OPEN:
        text = (
            f"the answer commands {opened[0]:g} while the gripper reads {reads:g}: here "
            "1 is open and 0 is closed (DROID and openpi have 1 for closed); send 1 - g if your policy means closed"
        )
        yield _warning("gripper", text)
    if actions[0].done:
        yield _warning("done", "the first action ends the trial, before the robot moves")
    for pose in (action.pose_tcp_in_base for action in actions):
        if pose is not None and pose.shape == (7,) and np.isfinite(pose).all() and pose[3:].any():
            yield from _look_at_pose(np.asarray(pose, np.float64), observation.pose_tcp_in_base)
            return


def _look_at_pose(target: F64, tool: F64) -> Iterator[CheckFinding]:
    distance = float(np.linalg.norm(target[:3] - tool[:3]))
    place, at = (" ".join(f"{value:.2f}" for value in pose[:3]) for pose in (target, tool))
    where = f"the first target is at {place} m and the tool at {at} m in base"
    if np.linalg.norm(target[:3]) < NEAR_BASE_M:
        yield _warning("difference", f"{where}: send absolute poses of the tool, not differences to it")
    elif distance > FAR_M:
        text = f"{where}, {distance:.2f} m away: check frame (base of the robot) and unit (metres)"
        yield _warning("position", text)
    turned, reordered = _angle_deg(target[3:], tool[3:]), _angle_deg(np.roll(target[3:], 1), tool[3:])
    turn = f"the first target turns the tool by {turned:.0f} degrees"
    if turned > WRONG_TURN_DEG and reordered < RIGHT_TURN_DEG:
        text = f"{turn}, or by {reordered:.0f} if x y z w was meant: send quaternions in the order w x y z"
        yield _warning("quaternion", text)
    elif turned > WRONG_TURN_DEG:
        yield _warning("orientation", f"{turn}: its z axis points out of the tool")


def _angle_deg(a: F64, b: F64) -> float:
    turn = matrix_from_quat(a / np.linalg.norm(a)).T @ matrix_from_quat(b / np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def numbers_of(actions: Sequence[Action]) -> F64:
    """Return all numbers (steps, columns) of actions, field by field; a missing number is 0."""
    rows: list[F64] = []
    for action in actions:
        values = (getattr(action, field.name) for field in fields(Action))
        rows.append(np.concatenate([np.ravel(np.asarray(0 if v is None else v, np.float64)) for v in values]))
    width = max(map(len, rows))
    return np.array([np.pad(row, (0, width - len(row))) for row in rows])


def joints_of(actions: Sequence[Action]) -> F64 | None:
    """Return the joint values (steps, joints) of actions; None if an action has none."""
    given = [action.joint for action in actions]
    return None if any(joint is None for joint in given) else np.array(given, np.float64)


def table(values: F64, *, now: F64, kind: str) -> list[str]:
    """Return one line for each column of (steps, columns): its range, and for joints their present angle ``now`` [rad].
    ``kind``: ``joints``, ``poses`` of the tool, or ``deltas``."""
    known_names = {"poses": POSE, "deltas": DELTA}
    names = known_names.get(kind, (*(f"joint {k + 1}" for k in range(len(now))), "gripper"))
    lines: list[str] = []
    for i, column in enumerate(values.T):
        known = column[np.isfinite(column)]
        name = names[i] if i < len(names) else f"column {i + 1}, unknown"
        span = f"{known.min():9.3f} to {known.max():9.3f}" if known.size else "no number"
        wrong = f"; {column.size - known.size} of {column.size} are not finite" if known.size < column.size else ""
        angle = f"; the angle is {now[i]:.3f} rad" if kind == "joints" and i < len(now) else ""
        lines.append(f"{name:16}{span}{angle}{wrong}")
    return lines


def look_at_joints(joints: F64, *, space: str, now: F64) -> Iterator[CheckFinding]:
    """Yield warnings about finite joint commands (steps, joints) of an action space; ``now``: the angles [rad]."""
    largest = float(np.abs(joints).max())
    from_now, from_zero = float(np.sqrt(((joints - now) ** 2).mean())), float(np.sqrt((joints**2).mean()))
    near = f"the actions differ from the joint angles by {from_now:.2f} and from zero by {from_zero:.2f} on average"
    wrong = "checkpoint, profile or space is the wrong one"
    if space == "droid_joint_velocity":
        if largest > TURN_RAD:
            text = f"velocities of up to {largest:.0f}: these look like degrees; send velocities that are normalised to"
            yield _warning("degrees", f"{text} [-1, 1]")
        elif from_now < NEARER * from_zero:
            text = f"{near}: they look like targets, but the action space is velocities: {wrong}"
            yield _warning("velocities", text)
        elif largest > NORMALISED:
            text = (
                f"{(np.abs(joints) > 1).mean():.0%} of the velocities lie beyond [-1, 1], up to {largest:.2f}, and are "
                "clipped: send normalised velocities, not rad/s"
            )
            yield _warning("velocities", text)
    elif space == "joint_position":
        if largest > TURN_RAD:
            yield _warning("degrees", f"targets of up to {largest:.0f}: these look like degrees; send radians")
        elif from_zero < NEARER * from_now and largest <= NORMALISED:
            text = f"{near}: they look like velocities or differences, but the action space is joint angles: {wrong}"
            yield _warning("targets", f"{text}, or the server has to add the angles")


def look_at_gripper(commands: F64, *, closed: float = 1.0, opened: float = 0.0) -> Iterator[CheckFinding]:
    """Yield findings about the last column (steps,). ``closed``, ``opened``: its numbers, DROID's by default."""
    shares = (commands - opened) / (closed - opened)
    if from_zero := list(_look_at_zero(commands, closed=closed, opened=opened)):
        yield from from_zero
        return
    if shares.min() < -GRIPPER_OVERSHOOT or shares.max() > 1 + GRIPPER_OVERSHOOT:
        text = (
            f"the gripper's column goes from {commands.min():.2f} to {commands.max():.2f}, expected {opened:g} (open) "
            f"to {closed:g} (closed); it is ignored, but its place or its convention is another one"
        )
        yield _warning("gripper", text)
    elif shares.max() < OPEN:
        text = (
            f"the observation says that the gripper is closed, and the server commands an open one ({opened:g}) in "
            "every step. It is ignored; if the server means a closed one, its polarity is the opposite of the profile's"
        )
        yield CheckFinding("hint", "gripper", text)


def _look_at_zero(commands: F64, *, closed: float, opened: float) -> Iterator[CheckFinding]:
    """Yield a warning if commands (steps,) have 0 in the place of -1."""
    low, high, shares = commands.min(), commands.max(), (commands - opened) / (closed - opened)
    undecided = ((OPEN < shares) & (shares < CLOSED)).all()
    if min(opened, closed) < 0 and (undecided or (-GRIPPER_OVERSHOOT <= low < OPEN and high <= 1 + GRIPPER_OVERSHOOT)):
        text = (
            f"the gripper's column goes from {low:.2f} to {high:.2f}, and never to -1, though {opened:g} is open and "
            f"{closed:g} is closed: it looks like a checkpoint's own range from 0 to 1, which the code of its data set "
            "turns into this one"
        )
        yield _warning("gripper", text)


def look_at_polarity(
    when_closed: F64, when_open: F64, *, closed: float = 1.0, opened: float = 0.0
) -> Iterator[CheckFinding]:
    """Yield a warning if the commands after a closed and an open gripper follow another convention."""
    ends = [(float(commands.mean()) - opened) / (closed - opened) for commands in (when_closed, when_open)]
    if ends[0] < OPEN and ends[1] > CLOSED:
        text = (
            f"where the gripper is observed as closed, the server commands an open one ({opened:g}), and the reverse: "
            f"its polarity looks like the opposite of the profile's, where {closed:g} is closed"
        )
        yield _warning("gripper", text)
    elif not list(_look_at_zero(when_closed, closed=closed, opened=opened)):
        # That would have been seen in the answer to the unchanged observation.
        yield from _look_at_zero(np.concatenate([when_closed, when_open]), closed=closed, opened=opened)


def _warning(topic: str, text: str) -> CheckFinding:
    return CheckFinding("warning", topic, text)
