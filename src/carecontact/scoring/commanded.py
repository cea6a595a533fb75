"""Where a policy meant to touch: contact of the commanded tool, and the target that it noted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from carecontact.interface.geometry import matrix_from_quat
from carecontact.recording import Recording
from carecontact.recording.notes import Note, read_notes
from carecontact.scoring.contact import F64, Contact, runs
from carecontact.scoring.progress import (
    count_reversals,
    distance_to_shadow,
    distance_to_surface,
    points_in_region,
    region_pose,
)

PATH_STEP_M = 0.005
MAX_LEG_POINTS = 2000
"""Largest number of points of one commanded leg, which suffices for 10 m: a target beyond any room is sampled more
coarsely."""
LOWEST_M = 0.001
"""Points that far above the lowest one are where the path was aimed: policies travel high and come down at the place
they mean."""


@dataclass(frozen=True, kw_only=True)
class CommandedPath:
    """Straight lines between the commanded TCP targets, from where the TCP was. K sampled points, M targets."""

    distance: F64
    """(K,) of each point to the surface of the target region as it then lay [m], negative inside"""
    beside_m: float
    """Smallest horizontal distance from the region of the points where the path was aimed; 0 above, on or under it"""
    target_time_s: F64
    """(M,)"""
    target_distance: F64
    """(M,)"""
    target_in_region: F64
    """(M, 3) in the region's frame [m]"""
    end_s: float
    """When the last target ceased to be in force: the trial's end"""

    @property
    def closest_m(self) -> float:
        return float(self.distance.min())

    def inside_at(self, time_s: float) -> bool:
        """Whether the target in force just before ``time_s`` lies on or under the region's surface."""
        before = int(np.searchsorted(self.target_time_s, time_s, side="left")) - 1
        return before >= 0 and bool(self.target_distance[before] <= 0.0)


@dataclass(frozen=True, kw_only=True)
class CommandedContact:
    """The longest stretch in which every target lay on or under the region's surface."""

    hold_s: float = 0.0
    way_m: float = 0.0
    """Distance from the stretch's first target to the farthest one"""
    stroke_m: float = 0.0
    """Along the axis, there and back"""
    extent_m: float = 0.0
    reversals: int = 0


def commanded_path(contact: Contact) -> CommandedPath | None:
    """Return the path of the tool's targets; None if no target was ever given."""
    recording = contact.recording
    pose = target_poses(recording)
    given = np.isfinite(pose).all(axis=1)
    if not given.any() or len(contact.time_s) == 0:
        return None
    targets = in_world(contact, pose[given, :3])
    time = recording["actions/time_s"][given]
    step = np.minimum(np.searchsorted(contact.time_s, time), len(contact.time_s) - 1)
    start = recording["scorer/pose_tcp_in_world"][step[:1], :3].astype(np.float64)

    corners = np.concatenate([start, targets])
    wanted = np.ceil(np.linalg.norm(np.diff(corners, axis=0), axis=1) / PATH_STEP_M)
    count = np.clip(wanted, 1, MAX_LEG_POINTS).astype(int)
    leg = np.repeat(np.arange(len(targets)), count)
    first = np.repeat(np.cumsum(count) - count, count)
    fraction = (np.arange(len(leg)) - first + 1) / count[leg]
    points = corners[leg] + fraction[:, None] * (corners[leg + 1] - corners[leg])

    pose_then, size = region_pose(contact, contact.task.region, step)
    in_region = points_in_region(points, pose_then[leg])
    distance = distance_to_surface(in_region, size)
    aimed = points[:, 2] <= points[:, 2].min() + LOWEST_M
    last = np.cumsum(count) - 1
    return CommandedPath(
        distance=distance,
        beside_m=float(distance_to_shadow(points[aimed], pose_then[leg[aimed]], size).min()),
        target_time_s=time,
        target_distance=distance[last],
        target_in_region=in_region[last],
        end_s=float(contact.time_s[-1]) + contact.dt_s,
    )


def target_poses(recording: Recording) -> F64:
    """(M, 7) pose in base that each action asks for, NaN where it kept the target; of joint actions, a period later."""
    joint = recording.arrays.get("actions/joint")
    if joint is None:
        return recording["actions/pose_tcp_in_base"]
    period = recording["scorer/period_time_s"]
    poses = np.full((len(joint), 7), np.nan)
    if len(period):
        after = np.searchsorted(period, recording["actions/time_s"], side="right")
        poses = recording["scorer/target_in_base"][np.minimum(after, len(period) - 1)].astype(np.float64)
    poses[np.isnan(joint).any(axis=1)] = np.nan
    return poses


def commanded_contact(path: CommandedPath, reversal_m: float) -> CommandedContact:
    """Return the contact of a tool that followed the commands exactly. ``reversal_m``: see ``count_reversals``."""
    until = np.append(path.target_time_s[1:], max(path.end_s, path.target_time_s[-1]))
    best = CommandedContact()
    for start, stop in runs(path.target_distance <= 0.0).tolist():
        targets = path.target_in_region[start:stop]
        found = CommandedContact(
            hold_s=float(until[stop - 1] - path.target_time_s[start]),
            way_m=float(np.linalg.norm(targets - targets[0], axis=1).max()),
            stroke_m=float(np.abs(np.diff(targets[:, 0])).sum()),
            extent_m=float(np.ptp(targets[:, 0])),
            reversals=count_reversals(targets[:, 0], reversal_m),
        )
        best = max(best, found, key=lambda c: c.hold_s)
    return best


def in_world(contact: Contact, points_in_base: F64) -> F64:
    """(N, 3) -> (N, 3)"""
    base = np.array(contact.recording.header.pose_base_in_world)
    return points_in_base @ matrix_from_quat(base[3:]).T + base[:3]


# The targets that a policy noted: their places, and the names that the policy gave them.

LONGEST_TEXT = 80


@dataclass(frozen=True, kw_only=True)
class NotedTarget:
    beside_m: float
    """Horizontal distance from the named region; 0 over it or under it"""
    over: str | None
    """Another region that it lies over, if it does not lie over the named one"""
    name: str | None
    """Subtask, or the region that was understood"""


def nearest_noted_target(contact: Contact) -> NotedTarget | None:
    """Return the noted target, ``target_m`` or a corner of the chosen option, that is nearest the named region."""
    times = contact.recording["policy/observation_time_s"].astype(np.float64)
    found: list[NotedTarget] = []
    for note in read_notes(contact.recording):
        index = note.observation_index
        if len(contact.time_s) == 0 or not 0 <= index < len(times):
            continue
        step = min(int(np.searchsorted(contact.time_s, float(times[index]))), len(contact.time_s) - 1)
        intent = _table(note.content.get("intent"))
        name = short(note.content.get("subtask")) or short(intent.get("region"))
        for place in _places(note):
            point = in_world(contact, place[None])
            beside = {
                region: float(distance_to_shadow(point, *region_pose(contact, region, np.array([step])))[0])
                for region in contact.recording.header.regions
            }
            own = beside.pop(contact.task.region)
            over = next((region for region in beside if own > 0 and beside[region] == 0.0), None)
            found.append(NotedTarget(beside_m=own, over=over, name=name))
    return min(found, key=lambda target: target.beside_m, default=None)


def noted_subtasks(contact: Contact) -> list[str]:
    """Return the subtasks that a policy noted which plans in words; empty where no note has any."""
    for note in read_notes(contact.recording):
        listed = note.content.get("subtasks")
        if isinstance(listed, list):
            return [text for item in cast("list[Any]", listed) if (text := short(item)) is not None]
    return []


def noted_reason(contact: Contact) -> str | None:
    """Return the reason that a policy noted for ending the trial."""
    contents = [note.content for note in reversed(read_notes(contact.recording))]
    keys = ("ended_because", "ended_without_touching")
    return next((text for content in contents for key in keys if (text := short(content.get(key))) is not None), None)


def short(text: object) -> str | None:
    """Return a policy's own words, shortened and on one line."""
    if not isinstance(text, str) or not text.split():
        return None
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_TEXT else f"{line[: LONGEST_TEXT - 3]}..."


def _table(value: object) -> dict[str, Any]:
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}


def _places(note: Note) -> Iterator[F64]:
    """The places of a note that are three numbers of a plausible size."""
    places: list[Any] = [note.content.get("target_m")]
    options, chosen = note.content.get("options"), note.content.get("chosen")
    if isinstance(options, list) and isinstance(chosen, int) and 0 <= chosen < len(cast("list[Any]", options)):
        corners: object = _table(cast("list[Any]", options)[chosen]).get("corners_m")
        places += cast("list[Any]", corners) if isinstance(corners, list) else []
    for place in places:
        if isinstance(place, list) and len(numbers := cast("list[Any]", place)) == 3:
            if all(isinstance(v, int | float) and abs(v) < 1e3 for v in numbers):
                yield np.array(numbers, np.float64)
