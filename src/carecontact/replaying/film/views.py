"""The names of the views that a video can have, and those views that do not depend on the contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, did_you_mean
from carecontact.recording.schema import Recording
from carecontact.replaying.film.stage import View

CONTACT, ORBIT = "contact", "orbit"
ViewAt = Callable[[float], View]
"""Time since t = 0 [s] -> the camera at that time."""
ORBIT_TURN_DEG_S = 9.0
ROOM_RADIUS_M = 2.2


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera that stands still, or turns round what it looks at."""

    view: View
    """at t = 0"""
    turn_deg_s: float = 0.0

    def __call__(self, time_s: float) -> View:
        return replace(self.view, azimuth_deg=self.view.azimuth_deg + self.turn_deg_s * time_s)


def view_names(protocol: Protocol) -> list[str]:
    """Return what ``--view`` takes under this protocol."""
    return [CONTACT, ORBIT, *protocol.cameras]


def check_view(name: str, protocol: Protocol) -> None:
    """Raises ConfigError for a name that no view has."""
    names = view_names(protocol)
    if name not in names:
        raise ConfigError(f"--view {name!r}{did_you_mean(name, names)}; valid: {', '.join(names)}")


def view_of(name: str, recording: Recording) -> ViewAt:
    """Return the orbit, or the view of the protocol's camera of this name."""
    spec = recording.header.spec
    column = recording.header.regions.index(spec.protocol.task(spec.task_id).region)
    middle = recording["scorer/region_pose_in_world"][0, column][:3].astype(np.float64)
    if name == ORBIT:
        far = View(look_at=middle, distance_m=1.5, azimuth_deg=60.0, elevation_deg=-28.0, radius_m=ROOM_RADIUS_M)
        return Camera(view=far, turn_deg_s=ORBIT_TURN_DEG_S)
    fixed = View(
        look_at=middle, distance_m=1.0, azimuth_deg=0.0, elevation_deg=-30.0, radius_m=ROOM_RADIUS_M, camera=name
    )
    return Camera(view=fixed)
