"""Controls of what a policy observes: the same policy with pictures of another person, with the first picture only, or
without the feel of its hand.

A rate alone does not say what a policy owes it to. A policy that succeeds as often with the pictures of another person
does not look at this one. The recording keeps what the policy was sent, so the altered pictures.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carecontact.errors import ConfigError
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.observation import F32, F64, CameraView, Observation
from carecontact.interface.robot import CARTESIAN_IMPEDANCE

if TYPE_CHECKING:
    from carecontact.episode.episode import Episode

Control = Callable[[Observation], Observation]
"""Takes what the policy would receive, with the new views only, and returns what it receives."""
SALT = hashlib.sha256(b"carecontact: persons of shuffled looks, version 1").hexdigest()
"""Salt of the persons whose pictures are shown in place of the trial's own. They come from the distribution of the
exam's persons; none of them is one of those, and none is one to train on."""


def control_of(name: str, episode: Episode, *, weights: Path | None) -> Control:
    """Return a control for one trial of an episode that has its card.

    Args:
        name: one of ``interface.policy.LOOK_CONTROLS``.
        weights: folder with the weights of the protocol's segmenter.

    Raises ConfigError for ``no-touch`` with a policy that commands joints.
    """
    if name == "frozen-look":
        return _Shown(None)
    return _NoTouch(episode) if name == "no-touch" else _Shown(_views_of_another(episode, weights))


class _Shown:
    """Shows the same views at every look: those of the first observation, or others."""

    def __init__(self, views: dict[str, CameraView] | None) -> None:
        self._views = views

    def __call__(self, observation: Observation) -> Observation:
        # The first observation has a view of every camera.
        self._views = views = self._views or observation.cameras
        time_s = observation.sim_time_s
        return replace(
            observation, cameras={name: replace(views[name], sim_time_s=time_s) for name in observation.cameras}
        )


def _views_of_another(episode: Episode, weights: Path | None) -> dict[str, CameraView]:
    """Return what the card's cameras see at t = 0 of another person, on whom the same task is to be done under the same
    protocol. Everything is as that trial's cell has it: its calibration, its robot's base and its noise."""
    from carecontact.episode.episode import Episode

    other = episode.spec.model_copy(update={"salt": SALT, "salt_sha256": ""})
    with Episode(other, card=episode.card, weights=weights, record=False) as donor:
        return donor.reset().cameras


class _NoTouch:
    """Shows the arm where its target is, so that the tool never lags behind it: what a person's body does to the hand
    is not to be felt.

    The tool is at the target of this moment, and a camera on the hand is known to be there, too. The joints stay at
    their first angles and have no speed, since the angles at the target are not unique.
    """

    def __init__(self, episode: Episode) -> None:
        card = episode.card
        if card is not None and card.control != CARTESIAN_IMPEDANCE:
            raise ConfigError(f"no-touch: it needs a policy that commands the tool, and {card.name} commands joints")
        self._episode = episode
        self._fixed = {name for name, camera in episode.protocol.cameras.items() if camera.mount == "world"}
        self._joints: F64 | None = None

    def __call__(self, observation: Observation) -> Observation:
        if self._joints is None:
            self._joints = observation.joint_position
        target = self._episode.simulation.control.target_in_base.copy()
        measured = observation.pose_tcp_in_base
        moved = _matrix(target) @ np.linalg.inv(_matrix(measured))
        cameras = {
            name: view if name in self._fixed else _moved(view, moved) for name, view in observation.cameras.items()
        }
        speed = observation.velocity_tcp_in_base
        return replace(
            observation,
            pose_tcp_in_base=target,
            joint_position=self._joints.copy(),
            joint_velocity=np.zeros_like(observation.joint_velocity),
            velocity_tcp_in_base=None if speed is None else np.zeros(6),
            cameras=cameras,
        )


def _matrix(pose: F64) -> F64:
    return pose_matrix(pose[:3], pose[3:])


def _moved(view: CameraView, moved: F64) -> CameraView:
    """Return a view as if its camera were moved in base by a transform (4, 4); its pictures stay."""
    return replace(
        view,
        pose_camera_in_base=moved @ view.pose_camera_in_base,
        points=_points(view.points, moved),
        landmarks_in_base=_points(view.landmarks_in_base, moved),
    )


def _points(points: F32 | None, moved: F64) -> F32 | None:
    return None if points is None else (points @ moved[:3, :3].T + moved[:3, 3]).astype(np.float32)
