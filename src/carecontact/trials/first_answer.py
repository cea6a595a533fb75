"""What a policy's first answer reveals about common mistakes: poses as differences, quaternion order, gripper polarity.

None of these breaks the contract, so a trial would run and fail for a reason that no score names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.action.hints import NEAR_BASE_M
from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.observation import Observation
from carecontact.trials.finding import Finding

F64 = npt.NDArray[np.float64]

FAR_M = 0.25
"""Distance of a first target from the tool that counts as far: a second of the fastest motion."""
WRONG_TURN_DEG, RIGHT_TURN_DEG = 90.0, 45.0
"""A first target that turns the tool by more, and by less if its quaternion is read as x y z w, has the other order."""
HALF_OPEN = 0.5


def look_at(actions: Sequence[Action], observation: Observation) -> list[Finding]:
    """Return warnings about an answer. A pose that the trial will refuse gives none: the refusal says more."""
    poses = [action.pose_tcp_in_base for action in actions if _is_pose(action.pose_tcp_in_base)]
    found = [*_gripper(actions, observation), *_end(actions)]
    if poses:
        first = np.asarray(poses[0], np.float64)
        found += [*_position(first, observation.pose_tcp_in_base), *_orientation(first, observation.pose_tcp_in_base)]
    return found


def _is_pose(given: F64 | None) -> bool:
    return given is not None and given.shape == (7,) and bool(np.isfinite(given).all()) and bool(given[3:].any())


def _position(target: F64, tool: F64) -> Iterator[Finding]:
    place, distance = target[:3], float(np.linalg.norm(target[:3] - tool[:3]))
    where = f"the first target is at {_numbers(place)} m and the tool at {_numbers(tool[:3])} m in base"
    if np.linalg.norm(place) < NEAR_BASE_M:
        yield Finding(
            level="warning", topic="difference", text=f"{where}: send absolute poses of the tool, not differences to it"
        )
    elif distance > FAR_M:
        yield Finding(
            level="warning",
            topic="position",
            text=f"{where}, {distance:.2f} m away: check frame (base of the robot) and unit (metres)",
        )


def _orientation(target: F64, tool: F64) -> Iterator[Finding]:
    as_sent, reordered = _angle_deg(target[3:], tool[3:]), _angle_deg(np.roll(target[3:], 1), tool[3:])
    if as_sent <= WRONG_TURN_DEG:
        return
    if reordered < RIGHT_TURN_DEG:
        text = f"the first target turns the tool by {as_sent:.0f} degrees, or by {reordered:.0f} if x y z w was meant"
        yield Finding(level="warning", topic="quaternion", text=f"{text}: send quaternions in the order w x y z")
    else:
        text = f"the first target turns the tool by {as_sent:.0f} degrees: its z axis points out of the tool"
        yield Finding(level="warning", topic="orientation", text=text)


def _gripper(actions: Sequence[Action], observation: Observation) -> Iterator[Finding]:
    opened = [action.gripper for action in actions if action.gripper is not None and action.gripper > HALF_OPEN]
    reads = float(observation.gripper_position[0])
    if opened and reads < HALF_OPEN:
        text = (
            f"the answer commands {opened[0]:g} while the gripper reads {reads:g}: here "
            "1 is open and 0 is closed (DROID and openpi have 1 for closed); send 1 - g if your policy means closed"
        )
        yield Finding(level="warning", topic="gripper", text=text)


def _end(actions: Sequence[Action]) -> Iterator[Finding]:
    if actions[0].done:
        yield Finding(level="warning", topic="done", text="the first action ends the trial, before the robot moves")


def _angle_deg(a: F64, b: F64) -> float:
    turn = matrix_from_quat(a / np.linalg.norm(a)).T @ matrix_from_quat(b / np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def _numbers(values: F64) -> str:
    return " ".join(f"{value:.2f}" for value in values)
