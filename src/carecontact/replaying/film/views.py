"""The views that a video can have: the protocol's cameras, a camera near the contact, and one that orbits it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, did_you_mean
from carecontact.recording.schema import Recording
from carecontact.regions import REGIONS
from carecontact.replaying.film.stage import View

CONTACT, ORBIT = "contact", "orbit"
ViewAt = Callable[[float], View]
"""Time since t = 0 [s] -> the camera at that time."""
BESIDE_DEG = 97.0
"""Between the region's axis and the direction in which the view near the contact looks: from the side, where the
skin's outline shows a dent."""
FLAT_DEG, STEEP_DEG = -22.0, -50.0
FAR_SIDE_M = 0.015
"""Where the contact lies farther behind the region's axis, the view looks over it."""
ORBIT_TURN_DEG_S = 9.0
ROOM_RADIUS_M = 2.2


def view_names(protocol: Protocol) -> list[str]:
    """What ``--view`` takes under this protocol."""
    return [CONTACT, ORBIT, *protocol.cameras]


def view_of(name: str, recording: Recording) -> ViewAt:
    """Return the view of this name. Raises ConfigError for a name that no view has."""
    spec = recording.header.spec
    names = view_names(spec.protocol)
    if name not in names:
        raise ConfigError(f"--view {name!r}{did_you_mean(name, names)}; valid: {', '.join(names)}")
    region = spec.protocol.task(spec.task_id).region
    column = recording.header.regions.index(region)
    pose = recording["scorer/region_pose_in_world"][0, column]
    length, _, height = recording["scorer/region_size_m"][column]
    middle = pose[:3].astype(np.float64)
    if name == CONTACT:
        touched, azimuth_deg = _touched(recording), _along_deg(pose) + BESIDE_DEG
        look = middle + [0.0, 0.0, 0.6 * height] if touched is None else touched
        forward = np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg)), 0.0])
        behind = float((look - middle) @ forward) > FAR_SIDE_M
        near = View(
            look_at=look, distance_m=max(0.42, 1.75 * length), azimuth_deg=azimuth_deg,
            elevation_deg=STEEP_DEG if behind else FLAT_DEG, radius_m=max(0.3, 1.2 * length), fovy_deg=30.0,
        )  # fmt: skip
        return lambda time_s: near
    if name == ORBIT:
        far = View(look_at=middle, distance_m=1.5, azimuth_deg=60.0, elevation_deg=-28.0, radius_m=ROOM_RADIUS_M)
        return lambda time_s: replace(far, azimuth_deg=far.azimuth_deg + ORBIT_TURN_DEG_S * time_s)
    fixed = View(
        look_at=middle, distance_m=1.0, azimuth_deg=0.0, elevation_deg=-30.0, radius_m=ROOM_RADIUS_M, camera=name
    )
    return lambda time_s: fixed


def _along_deg(pose: np.ndarray) -> float:
    """Azimuth of the region's axis."""
    x, y, _ = matrix_from_quat(pose[3:].astype(np.float64))[:, 0]
    return float(np.degrees(np.arctan2(y, x)))


def _touched(recording: Recording) -> np.ndarray | None:
    """(3,) middle of the places at which the named region's segment was touched; None if it never was."""
    spec = recording.header.spec
    segment = recording.header.segments.index(REGIONS[spec.protocol.task(spec.task_id).region].segment)
    on = recording["scorer/normal_force"][:, segment] > 0
    if not on.any():
        return None
    places = recording["scorer/centroid_in_world"][on, segment].astype(np.float64)
    return (places.min(0) + places.max(0)) / 2
