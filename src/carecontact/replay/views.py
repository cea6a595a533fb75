"""From where a video looks, and how the view of the contact is kept clear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError, did_you_mean
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.regions import REGIONS
from carecontact.protocol.protocol import Protocol
from carecontact.recording.schema import Recording
from carecontact.replay.replay import STATE
from carecontact.replay.stage import FilmSkin, View

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
    """Return what ``--camera`` takes under this protocol."""
    return [CONTACT, ORBIT, *protocol.cameras]


def check_view(name: str, protocol: Protocol) -> None:
    """Raises ConfigError for a name that no view has."""
    names = view_names(protocol)
    if name not in names:
        raise ConfigError(f"--camera {name!r}{did_you_mean(name, names)}; valid: {', '.join(names)}")


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


# Chooses where a camera near the contact stands, so that nothing hides the skin that is touched.
#
# The robot reaches over the person, and limbs have a far side, so that no side of a region is always clear. Rays
# decide: they go from the skin round each recorded contact to the places where the camera could stand.

F64 = npt.NDArray[np.float64]

TURNS_DEG = (97.0, -97.0, 127.0, -127.0, 67.0, -67.0, 157.0, -157.0, 166.0, -166.0, 180.0, 15.0, -15.0)
"""Angles between the region's axis and the level direction of the view, the preferred one first. From the side, the
skin's outline shows a dent. A hand that pushes from the side hides it from there, so that the last views look along the
region."""
ELEVATIONS_DEG = (-22.0, -36.0, -50.0, -66.0, -8.0)
"""Angles of the view above the horizon, the preferred one first: the flatter the view, the better the outline shows.
The flattest one comes last because a bed and a trunk often hide what it shows."""
CLEAR_SHARE = 0.8
"""The first view is taken whose merit is at least this part of the best one's."""
RING_M = (0.006, 0.030)
"""The skin counts that lies between these distances from the middle of a contact; the tool itself covers what is
nearer, from every side."""
FACING = 0.15
"""Least cosine between the skin's normal and the direction to the camera at which the skin can be made out."""
OFF_SKIN_M = 0.010
"""Rays begin at this distance from the skin, because the solid parts under it do not end exactly at it."""
MOMENTS = 6
"""Number of recorded states with contact that are looked at, at most."""


def clear_view(recording: Recording, model: mujoco.MjModel, skin: FilmSkin) -> View:
    """Return the view of the named region that shows its contacts best, in a film's model (``film_scene``) and skin."""
    spec = recording.header.spec
    region = spec.protocol.task(spec.task_id).region
    column = recording.header.regions.index(region)
    pose = recording["scorer/region_pose_in_world"][0, column].astype(np.float64)
    length, _, height = recording["scorer/region_size_m"][column]
    x, y, _ = matrix_from_quat(pose[3:])[:, 0]
    along_deg = float(np.degrees(np.arctan2(y, x)))
    touched = _touched(recording, REGIONS[region].segment)
    look_at = pose[:3] + [0.0, 0.0, 0.6 * height] if touched is None else touched
    first = View(
        look_at=look_at, distance_m=max(0.42, 1.75 * length), azimuth_deg=along_deg + TURNS_DEG[0],
        elevation_deg=ELEVATIONS_DEG[0], radius_m=max(0.3, 1.2 * length), fovy_deg=30.0, light_turns=True,
    )  # fmt: skip
    views = [
        replace(first, azimuth_deg=along_deg + turn_deg, elevation_deg=elevation_deg)
        for elevation_deg, turn_deg in product(ELEVATIONS_DEG, TURNS_DEG)
    ]
    spots = _spots(recording, REGIONS[region].segment)
    if not spots:
        return first
    merit = np.mean([_merits(model, skin, state, centre, views) for state, centre in spots], axis=0)
    return views[int(np.argmax(merit >= CLEAR_SHARE * merit.max()))]


def _touched(recording: Recording, segment: str) -> F64 | None:
    """(3,) middle of all places at which a segment was touched [m]; None if it never was."""
    column = recording.header.segments.index(segment)
    on = recording["scorer/normal_force"][:, column] > 0
    if not on.any():
        return None
    places = recording["scorer/centroid_in_world"][on, column].astype(np.float64)
    return (places.min(0) + places.max(0)) / 2


def _spots(recording: Recording, segment: str) -> list[tuple[F64, F64]]:
    """Return the stored states in which a segment is touched and the one nearest to its peak force, each with the
    force-weighted middle (3,) of the contact [m]."""
    column = recording.header.segments.index(segment)
    force = recording["scorer/normal_force"][:, column]
    if not force.any():
        return []
    dt_s = recording.header.spec.protocol.physics.dt_s
    stored_s = recording["state/time_s"]
    steps = np.minimum(np.round(stored_s / dt_s).astype(int), len(force) - 1)
    peak = int(force.argmax())
    rows = np.flatnonzero(force[steps] > 0)
    rows = rows[np.linspace(0, len(rows) - 1, min(MOMENTS, len(rows))).astype(int)]
    at = {int(row): int(steps[row]) for row in rows}
    at[int(np.abs(steps - peak).argmin())] = peak
    places = recording["scorer/centroid_in_world"][:, column].astype(np.float64)
    return [(recording["state/integration"][row], places[step]) for row, step in at.items()]


def _merits(model: mujoco.MjModel, skin: FilmSkin, state: F64, centre: F64, views: list[View]) -> F64:
    """(views,) part of the skin round a contact that each sees, times the sine of the angle to its normal: a dent shows
    in the outline."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, STATE)
    mujoco.mj_kinematics(model, data)
    vertices, normals = skin.placed(data)
    apart = np.linalg.norm(vertices - centre, axis=1)
    near = (apart > RING_M[0]) & (apart < RING_M[1])
    vertices, normals = vertices[near][::4], normals[near][::4]
    if not len(vertices):
        return np.zeros(len(views))
    outward = normals.mean(0) / np.linalg.norm(normals.mean(0))
    eyes = np.array([eye_place(view) for view in views])
    sine = np.linalg.norm(np.cross(eyes - centre, outward), axis=1) / np.linalg.norm(eyes - centre, axis=1)
    return sine * [_share_seen(model, data, vertices, normals, eye) for eye in eyes]


def _share_seen(model: mujoco.MjModel, data: mujoco.MjData, vertices: F64, normals: F64, eye: F64) -> float:
    """Part of the vertices from which a ray reaches the camera."""
    way = eye - vertices
    length = np.linalg.norm(way, axis=1)
    way /= length[:, None]
    hit, clear = np.zeros(1, np.int32), 0
    for k in np.flatnonzero((way * normals).sum(1) > FACING):
        start = vertices[k] + OFF_SKIN_M * way[k]
        distance = mujoco.mj_ray(model, data, start, way[k], None, 1, -1, hit)
        clear += distance < 0 or distance > length[k]
    return clear / len(vertices)


def eye_place(view: View) -> F64:
    """(3,) where the camera of a view stands [m]; only for views without a camera of the protocol."""
    azimuth, elevation = np.radians(view.azimuth_deg), np.radians(view.elevation_deg)
    level = np.cos(elevation)
    forward = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    return view.look_at - view.distance_m * forward
