"""Which views a policy receives: those of cameras that are due or that an action names, and controls that alter them.

A control is the same policy with pictures of another person, with the first picture only, or without the feel of its
hand: a rate alone does not say what a policy owes it to. The recording keeps what the policy was sent, so the altered
pictures.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection
from dataclasses import replace
from math import floor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError, ConfigError
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.observation import F32, F64, CameraView, LastViews, Observation
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.interface.robot import CARTESIAN_IMPEDANCE

if TYPE_CHECKING:
    from carecontact.episode.episode import Episode

ROUNDING_S = 1e-6
"""Less than this is rounding, when an observation comes exactly one physics step before an interval."""


def flags(cameras: Collection[str]) -> npt.NDArray[np.uint8]:
    """Return (V,) 1 for each of CAMERAS that is among ``cameras``, as recordings keep it."""
    return np.array([name in cameras for name in CAMERAS], np.uint8)


class Looks:
    """The cameras of one trial in time.

    A camera with a rate of r Hz is due in the first observation of each interval from k / r to (k + 1) / r. Control
    periods are whole physics steps, which may put an observation before the interval to which it belongs, by less than
    one step: it counts as inside. A view that an action asks for does not delay the next one that is due.
    """

    def __init__(self, card: PolicyCard, *, dt_s: float) -> None:
        """``dt_s``: length of a physics step [s]."""
        self._card, self._early_s = card, dt_s - ROUNDING_S
        self._interval: dict[str, int] = {}
        """Camera -> number of the interval in which it took its last view."""
        self._asked: set[str] = set()
        self._last = LastViews()

    def check(self, look: Collection[str]) -> None:
        """Raises ActionError for a camera that the card does not name."""
        if isinstance(look, str):
            raise ActionError(f'look: expected a tuple of cameras, such as ("{look}",), got "{look}"')
        if unknown := [name for name in look if name not in self._card.cameras]:
            raise ActionError(f"look: no camera {unknown[0]!r} on the card; valid: {', '.join(self._card.cameras)}")

    def ask(self, look: Collection[str]) -> None:
        """Let these cameras take a view for the next observation."""
        self._asked |= set(look)

    def due(self, sim_time_s: float) -> tuple[str, ...]:
        """Return the cameras that take a view for the observation at this time, in the order of the card."""
        rates, at_s = self._card.camera_hz, sim_time_s + self._early_s
        now = {name: floor(at_s * rates.get(name, 0.0)) for name in self._card.cameras}
        taking = tuple(
            name
            for name, number in now.items()
            if name in self._asked or name not in rates or number > self._interval.get(name, -1)
        )
        self._interval |= {name: now[name] for name in taking}
        self._asked.clear()
        return taking

    def completed(self, observation: Observation) -> Observation:
        """Return an observation of the cameras that were due with the last views of the others."""
        return self._last.completed(observation)


Control = Callable[[Observation], Observation]
"""Takes what the policy would receive, with the new views only, and returns what it receives."""
SALT = hashlib.sha256(b"carecontact: persons of shuffled looks, version 1").hexdigest()
"""Salt of the persons whose pictures are shown in place of the trial's own. They come from the distribution of the
exam's persons; none of them is one of those, and none is one to train on."""


def control_of(name: str, episode: Episode, *, weights: Path | None) -> Control:
    """Return a control of LOOK_CONTROLS for one trial; raises ConfigError for ``no-touch`` if the policy commands
    joints."""
    if name == "no-touch":
        return _NoTouch(episode)
    return _Shown(None if name == "frozen-look" else _views_of_another(episode, weights))


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
    """Return what the cameras see at t = 0 of another person under the same protocol, as that trial's cell has it."""
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
        moved = pose_matrix(target[:3], target[3:]) @ np.linalg.inv(pose_matrix(measured[:3], measured[3:]))
        # The views of a camera on the hand move with it; their pictures stay.
        cameras = {
            name: view
            if name in self._fixed
            else replace(
                view,
                pose_camera_in_base=moved @ view.pose_camera_in_base,
                points=_points(view.points, moved),
                landmarks_in_base=_points(view.landmarks_in_base, moved),
            )
            for name, view in observation.cameras.items()
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


def _points(points: F32 | None, moved: F64) -> F32 | None:
    return None if points is None else (points @ moved[:3, :3].T + moved[:3, 3]).astype(np.float32)
