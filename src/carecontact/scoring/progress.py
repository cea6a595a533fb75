"""How far the tool wiped and how far the arm was moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.scoring.contact import Contact, Mask, episodes, runs
from carecontact.scoring.filters import F64, low_pass
from carecontact.scoring.region import points_in_region


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


def surface_track(contact: Contact) -> Track:
    """Follow the TCP over the target region's surface, in the bone's frame, so that a moving arm is not a stroke."""
    recording, definition = contact.recording, contact.protocol.contact
    stride = max(1, round(1.0 / (definition.stroke_sample_hz * contact.dt_s)))
    step = np.arange(0, len(contact.time_s), stride)
    region = recording.header.regions.index(contact.task.region)
    tcp = recording["scorer/pose_tcp_in_world"][step, :3].astype(np.float64)
    pose = recording["scorer/region_pose_in_world"][step, region].astype(np.float64)
    point = points_in_region(tcp, pose)
    radius = float(recording["scorer/region_size_m"][region, 2])
    around = np.unwrap(np.arctan2(point[:, 1], point[:, 2])) * radius
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
    """(N,) positions without a gap -> indices of the outermost position before each change of direction; a change is
    one where ``threshold`` has been travelled back."""
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
