"""How far the tool and the person moved while in contact: strokes along a region, passes, and the wrist's way."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat
from carecontact.scoring.contact import F64, Contact, Mask, episodes, held_force, in_band, low_pass, runs


def points_in_region(points_in_world: F64, region_pose_in_world: F64) -> F64:
    """(N, 3) points, (N, 7) region poses -> (N, 3) coordinates: x along the bone, z outward [m]."""
    rotation = matrix_from_quat(region_pose_in_world[:, 3:])
    offset = points_in_world - region_pose_in_world[:, :3]
    return np.einsum("nij,ni->nj", rotation, offset)


def distance_to_surface(points: F64, size: F64) -> F64:
    """(N, 3) points in the region's frame -> (N,) signed distance from its surface [m], negative inside.

    ``size`` (3,) is length, half width (y) and outward radius (z). The region is taken as a straight elliptic
    cylinder about the x axis with the frame's origin at its middle. Distance is measured along the ray from the
    axis, exact for a round limb.
    """
    length, half_width, outward = (float(s) for s in size)
    along, across = np.abs(points[:, 0]) - length / 2, points[:, 1:]
    from_axis = np.linalg.norm(across, axis=1)
    relative = np.hypot(across[:, 0] / half_width, across[:, 1] / outward)
    # On the axis itself the ray has no direction; the nearest surface is the smaller radius away.
    on_axis = relative < 1e-9
    scale = np.where(on_axis, 1.0, relative)
    radial = np.where(on_axis, -min(half_width, outward), from_axis * (1.0 - 1.0 / scale))
    return np.where(along > 0, np.hypot(np.maximum(radial, 0.0), np.maximum(along, 0.0)), radial)


def surface_normal(points: F64, size: F64) -> F64:
    """(N, 3) points in the region's frame -> (N, 3) outward unit normal of the cylinder's side through each.

    A point on the axis itself gets the z axis.
    """
    _, half_width, outward = (float(s) for s in size)
    gradient = np.stack([np.zeros(len(points)), points[:, 1] / half_width**2, points[:, 2] / outward**2], axis=1)
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    on_axis = length < 1e-9
    return np.where(on_axis, [0.0, 0.0, 1.0], gradient / np.where(on_axis, 1.0, length))


def distance_to_shadow(points_in_world: F64, region_pose_in_world: F64, size: F64) -> F64:
    """(N, 3) points, (N, 7) region poses -> (N,) horizontal distance from the region's shadow on the floor [m], 0 over
    it or under it.

    The shadow is taken as a rectangle: as long as the axis looks from above, as wide as the region.
    """
    rotation = matrix_from_quat(region_pose_in_world[:, 3:])
    axis = rotation[:, :2, 0]
    length = np.linalg.norm(axis, axis=1)
    # An upright axis has no direction from above; any will do for a shadow of length 0.
    upright = length < 1e-9
    direction = np.where(upright[:, None], [1.0, 0.0], axis / np.where(upright, 1.0, length)[:, None])
    offset = (points_in_world - region_pose_in_world[:, :3])[:, :2]
    along = np.abs(np.einsum("ni,ni->n", offset, direction)) - length * float(size[0]) / 2
    across = np.abs(offset[:, 0] * direction[:, 1] - offset[:, 1] * direction[:, 0]) - float(size[1])
    return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))


# How far the tool wiped and how far the arm was moved.


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One contact episode, [start, stop) in physics steps."""

    start: int
    stop: int
    on_share: float
    """Share of its time that the neighbourhood is on."""
    stroke_m: float
    """Path length along axis and circumference while on."""
    extent_m: float
    """P95 - P5 along the axis while on."""
    reversals: int
    """Reversals in the stretch without a gap that has most of them: lifting and returning is not a reversal."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """TCP in the region's frame, decimated: N samples."""

    step: npt.NDArray[np.intp]
    """(N,) physics steps"""
    surface: F64
    """(N, 2) along the axis and along the circumference [m]"""
    on: Mask
    """(N,) neighbourhood on at the sample"""
    joined: Mask
    """(N - 1,) neighbourhood on at every physics step from one sample to the next"""


def measure_episodes(contact: Contact) -> list[Episode]:
    """Return every contact episode of the trial, in order."""
    found = episodes(contact)
    if not found:
        return []
    track = surface_track(contact)
    return [_measure(contact, track, start, stop) for start, stop in found]


def region_pose(contact: Contact, region: str, step: npt.NDArray[np.intp]) -> tuple[F64, F64]:
    """(N, 7) poses in the world of a region at physics steps (N,), and its size (3,) [m]."""
    index = contact.recording.header.regions.index(region)
    pose = contact.recording["scorer/region_pose_in_world"][step, index].astype(np.float64)
    return pose, contact.recording["scorer/region_size_m"][index].astype(np.float64)


def surface_track(contact: Contact) -> Track:
    """Follow the TCP over the target region's surface, in the bone's frame, so that a moving arm is not a stroke."""
    recording, definition = contact.recording, contact.protocol.contact
    stride = max(1, round(1.0 / (definition.stroke_sample_hz * contact.dt_s)))
    step = np.arange(0, len(contact.time_s), stride)
    pose, size = region_pose(contact, contact.task.region, step)
    point = points_in_region(recording["scorer/pose_tcp_in_world"][step, :3].astype(np.float64), pose)
    around = np.unwrap(np.arctan2(point[:, 1], point[:, 2])) * float(size[2])
    surface = low_pass(
        np.stack([point[:, 0], around], axis=1),
        cutoff_hz=definition.stroke_filter_hz,
        sample_hz=1.0 / (stride * contact.dt_s),
        zero_phase=True,
    )
    on = contact.neighbourhood_on
    off_before = np.concatenate([[0], np.cumsum(~on)])
    joined = off_before[step[1:] + 1] == off_before[step[:-1]]
    return Track(step=step, surface=surface, on=on[step], joined=joined)


def _measure(contact: Contact, track: Track, start: int, stop: int) -> Episode:
    inside = (track.step >= start) & (track.step < stop)
    joined = track.joined & inside[:-1] & inside[1:]
    lengths = np.linalg.norm(np.diff(track.surface, axis=0), axis=1)
    axis = track.surface[:, 0]
    touching = axis[inside & track.on]
    extent = float(np.subtract(*np.percentile(touching, [95, 5]))) if len(touching) else 0.0
    threshold = contact.protocol.contact.reversal_m
    return Episode(
        start=start,
        stop=stop,
        on_share=float(contact.neighbourhood_on[start:stop].mean()),
        stroke_m=float(lengths[joined].sum()),
        extent_m=extent,
        reversals=max((count_reversals(axis[a : b + 1], threshold) for a, b in runs(joined).tolist()), default=0),
    )


def count_reversals(position: F64, threshold: float) -> int:
    """(N,) positions without a gap -> changes of direction, each counted once ``threshold`` has been travelled back."""
    return len(turning_points(position, threshold))


def turning_points(position: F64, threshold: float) -> list[int]:
    """(N,) positions without a gap -> where each turn is outermost; a turn is one after ``threshold`` of way back."""
    found: list[int] = []
    direction = low_at = high_at = 0
    low = high = float(position[0]) if len(position) else 0.0
    for i, value in enumerate(position.tolist()):
        if value < low:  # by hand: min and max take four times as long
            low, low_at = value, i
        if value > high:
            high, high_at = value, i
        if direction >= 0 and high - value >= threshold:
            if direction > 0:
                found.append(high_at)
            direction, low, low_at = -1, value, i
        elif direction <= 0 and value - low >= threshold:
            if direction < 0:
                found.append(low_at)
            direction, high, high_at = 1, value, i
    return found


def wrist_displacement(contact: Contact) -> tuple[float, float]:
    """Largest horizontal distance of the wrist from its settled place [m]: while the neighbourhood is on, and ever."""
    recording = contact.recording
    offset = recording["scorer/wrist_in_world"].astype(np.float64) - recording["scorer/wrist_settled_in_world"]
    distance = np.linalg.norm(offset[:, :2], axis=1)
    return (
        float(distance[contact.neighbourhood_on].max(initial=0.0)),
        float(distance.max(initial=0.0)),
    )


def wrist_from_onset(contact: Contact) -> float:
    """Largest horizontal distance of the wrist from where it was when the contact episode began [m]; of all episodes of
    the tool's contact, while the tool touches the neighbourhood.

    What the person does before the contact does not count. What it does during the contact does: the recording has one
    way of one wrist, which person and robot make together, and no part of it belongs to one of them.
    """
    wrist = contact.recording["scorer/wrist_in_world"][:, :2].astype(np.float64)
    moved = 0.0
    for start, stop in episodes(contact.of_tool):
        way = np.linalg.norm(wrist[start:stop] - wrist[start], axis=1)
        moved = max(moved, float(way[contact.tool_on[start:stop]].max(initial=0.0)))
    return moved


# How often the tool passed each part of the region's axis, and with what force it slid.

STEP_M = 0.001
"""Length of the parts of the axis that are counted."""


@dataclass(frozen=True, kw_only=True)
class Wiping:
    """The tool's way over the target region's surface with the force at each sample (50 Hz); N samples."""

    track: Track
    force: F64
    """(N,) held force of the tool [N]"""
    whole: F64
    """(N,) held force of the whole robot [N]"""
    length_m: float
    """Length of the region's axis."""
    reversal_m: float
    """Opposite travel that begins another stroke."""
    moving: Mask
    """(N - 1,) in contact from one sample to the next and sliding faster than the least speed that counts as motion"""

    def passes(self, least_n: float) -> npt.NDArray[np.intp]:
        """(K,) how often each STEP_M of the axis was passed with at least this force.

        A *stroke* is the path between two turns or lifts, and passes each place at most once: trembling on a place is
        no wiping. Strokes count in either direction, also where the tool is lifted and comes back through the air, as
        a nurse may wipe.
        """
        count = np.zeros(round(self.length_m / STEP_M), np.intp)
        axis = self.track.surface[:, 0]
        hard = self.force >= least_n
        for start, stop in runs(self.track.joined).tolist():
            ends = [0, *turning_points(axis[start : stop + 1], self.reversal_m), stop - start]
            for first, last in pairwise(ends):
                stroke = slice(start + first, start + last + 1)
                count += self._covered(axis[stroke], hard[stroke], len(count))
        return count

    def _covered(self, axis: F64, hard: Mask, parts: int) -> Mask:
        """(K,) which parts' middles one stroke goes over while it is pressed hard enough."""
        found = np.zeros(parts, np.bool_)
        for start, stop in runs(hard).tolist():
            place = (axis[start:stop] + self.length_m / 2) / STEP_M - 0.5
            low, high = int(np.ceil(place.min())), int(np.floor(place.max()))
            found[max(low, 0) : max(high + 1, 0)] = True
        return found

    def passed_m(self, times: float, least_n: float) -> float:
        """Length of the axis that was passed at least so often with at least this force [m]."""
        return float((self.passes(least_n) >= times).sum()) * STEP_M

    def share_in_band(self, least_n: float, most_n: float) -> float | None:
        """Share of sliding time with at least ``least_n`` of the tool, at most ``most_n`` of the robot; None if it
        never slid."""
        tool, whole = self.force[1:][self.moving], self.whole[1:][self.moving]
        return float(in_band(tool, whole, least_n, most_n).mean()) if len(tool) else None


def wiping(contact: Contact) -> Wiping:
    """Return how the tool slid over the whole trial, because what slid too hard counts in whichever contact it was."""
    definition, track = contact.protocol.contact, surface_track(contact.of_tool)
    speed = np.linalg.norm(np.diff(track.surface, axis=0), axis=1) / np.diff(contact.time_s[track.step])
    region = contact.recording.header.regions.index(contact.task.region)
    return Wiping(
        track=track,
        force=held_force(contact.of_tool)[track.step],
        whole=held_force(contact)[track.step],
        length_m=float(contact.recording["scorer/region_size_m"][region, 0]),
        reversal_m=definition.reversal_m,
        moving=track.joined & (speed >= definition.active_speed_m_s),
    )
