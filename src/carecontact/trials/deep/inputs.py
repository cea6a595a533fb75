"""The pieces of what a policy is shown, and how each is blanked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from carecontact.contract.observation import CameraView, Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.hosting.dialects.again import dialect_of, observation_again, unpacked
from carecontact.trials.deep.messages import camera_names, leaves

GREY = 127
INSTRUCTION = "do nothing"
"""Replaces the task's instruction: another text and not an empty one, which some servers refuse."""
MOVING_RAD_S = 0.2
OPENING = 1.0
"""Replaces the gripper's reading, which is always closed here: it is the opposite value."""


@dataclass(frozen=True, kw_only=True)
class Input:
    """One piece of an observation."""

    name: str
    """Keys under which the piece is sent."""
    is_gripper: bool = False
    needed: bool
    """Whether it is suspicious if a policy does not use the piece. Many do not use the tool's pose, for example."""
    blank: Callable[[Observation], Observation]
    """Returns the observation with this piece blanked; the result is a valid observation within the robot's limits."""


def inputs_of(observation: Observation, card: PolicyCard, session: Session, *, sent: bytes) -> list[Input]:
    """Return every piece that a policy with this card is sent.

    Args:
        sent: the message that carried the observation.
    """
    dialect = dialect_of(card.arguments)

    def message(seen: Observation) -> dict[str, object]:
        again = observation_again(seen, card.arguments, card.cameras, sent=sent)
        return leaves(unpacked(again, dialect))

    whole, found = message(observation), list[Input]()
    cameras = camera_names(card)
    for candidate in _candidates(card, session, joints_needed=bool(dialect)):
        blanked = message(candidate.blank(observation))
        changed = [key for key, value in whole.items() if not _equal(value, blanked.get(key))]
        if not changed:
            continue
        what = f"camera {candidate.name}" if candidate.name in cameras.values() else candidate.name
        shown = changed[0] if len(changed) == 1 else changed[0].rpartition(".")[0]
        found.append(replace(candidate, name=f"{shown} ({what})"))
    return found


def _candidates(card: PolicyCard, session: Session, *, joints_needed: bool) -> Iterator[Input]:
    low, high = np.array(session.joint_low_rad), np.array(session.joint_high_rad)
    box = np.array([session.action_bounds.workspace_low_m, session.action_bounds.workspace_high_m])
    if card.modalities:
        for camera in card.cameras:
            yield Input(name=camera, needed=True, blank=lambda seen, camera=camera: _without_view(seen, camera))
    yield Input(name="instruction", needed=True, blank=lambda seen: replace(seen, instruction=INSTRUCTION))
    yield Input(
        name="joint angles", needed=joints_needed, blank=lambda seen: replace(seen, joint_position=(low + high) / 2)
    )
    yield Input(
        name="gripper", needed=False, is_gripper=True,
        blank=lambda seen: replace(seen, gripper_position=np.full(1, OPENING)),
    )  # fmt: skip
    yield Input(
        name="pose of the tool", needed=False,
        blank=lambda seen: replace(seen, pose_tcp_in_base=np.r_[box.mean(0), seen.pose_tcp_in_base[3:]]),
    )  # fmt: skip
    yield Input(
        name="joint velocities", needed=False,
        blank=lambda seen: replace(seen, joint_velocity=np.full_like(seen.joint_velocity, MOVING_RAD_S)),
    )  # fmt: skip


def _without_view(seen: Observation, camera: str) -> Observation:
    return replace(seen, cameras={**seen.cameras, camera: _empty(seen.cameras[camera])})


def _empty(view: CameraView) -> CameraView:
    """Return a view with a grey picture, no depth, and nothing that was found in it."""
    return replace(
        view,
        rgb=None if view.rgb is None else np.full_like(view.rgb, GREY),
        depth=None if view.depth is None else np.full_like(view.depth, np.nan),
        points=None if view.points is None else view.points[:0],
        point_colors=None if view.point_colors is None else view.point_colors[:0],
        masks=None if view.masks is None else {name: np.zeros_like(mask) for name, mask in view.masks.items()},
        landmarks=None if view.landmarks is None else np.full_like(view.landmarks, np.nan),
        landmarks_in_base=None if view.landmarks_in_base is None else np.full_like(view.landmarks_in_base, np.nan),
    )


def _equal(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape and a.tobytes() == b.tobytes()
    return a is b or bool(a == b)
