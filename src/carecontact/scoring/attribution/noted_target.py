"""Reads the targets that a policy noted: their places, and the names that the policy gave them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from carecontact.recording.notes import Note, read_notes
from carecontact.scoring.attribution.commanded import in_world, region_pose
from carecontact.scoring.contact import Contact
from carecontact.scoring.filters import F64
from carecontact.scoring.region import distance_to_shadow

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
    """Return the noted target that is horizontally nearest the named region; None where no note holds one.

    Understood are ``target_m`` (a place in the robot's base) with ``subtask``, and ``options``, ``chosen`` and
    ``intent``; what is not of their form is passed over.
    """
    times = contact.recording["policy/observation_time_s"].astype(np.float64)
    found: list[NotedTarget] = []
    for note in read_notes(contact.recording):
        index = note.observation_index
        if len(contact.time_s) == 0 or not 0 <= index < len(times):
            continue
        step = min(int(np.searchsorted(contact.time_s, float(times[index]))), len(contact.time_s) - 1)
        for place in _places(note):
            point = in_world(contact, place[None])
            beside = {
                region: float(distance_to_shadow(point, *region_pose(contact, region, np.array([step])))[0])
                for region in contact.recording.header.regions
            }
            own = beside.pop(contact.task.region)
            over = min(beside, key=lambda region: beside[region]) if beside and own > 0 else None
            found.append(
                NotedTarget(beside_m=own, over=over if over and beside[over] == 0.0 else None, name=_name(note))
            )
    return min(found, key=lambda target: target.beside_m, default=None)


def noted_subtasks(contact: Contact) -> list[str]:
    """Return what a policy that plans in words says it set out to do (``subtasks``); empty where no note says."""
    for note in read_notes(contact.recording):
        listed = note.content.get("subtasks")
        if isinstance(listed, list):
            return [text for item in cast("list[Any]", listed) if (text := short(item)) is not None]
    return []


def noted_reason(contact: Contact) -> str | None:
    """Return the reason that a policy noted for ending the trial."""
    for note in reversed(read_notes(contact.recording)):
        for key in ("ended_because", "ended_without_touching"):
            if (text := short(note.content.get(key))) is not None:
                return text
    return None


def short(text: object) -> str | None:
    """Return a policy's own words, shortened and on one line."""
    if not isinstance(text, str) or not text.split():
        return None
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_TEXT else f"{line[: LONGEST_TEXT - 3]}..."


def _places(note: Note) -> Iterator[F64]:
    content = note.content
    yield from _points([content.get("target_m")])
    options, chosen = content.get("options"), content.get("chosen")
    if isinstance(options, list) and isinstance(chosen, int) and 0 <= chosen < len(cast("list[Any]", options)):
        option = cast("list[Any]", options)[chosen]
        if isinstance(option, dict):
            yield from _points(cast("dict[str, Any]", option).get("corners_m"))


def _points(values: object) -> Iterator[F64]:
    for value in cast("list[Any]", values) if isinstance(values, list) else []:
        if isinstance(value, list) and len(cast("list[Any]", value)) == 3:
            numbers = cast("list[Any]", value)
            if all(isinstance(v, (int, float)) and abs(v) < 1e3 for v in numbers):
                yield np.array(numbers, np.float64)


def _name(note: Note) -> str | None:
    intent = note.content.get("intent")
    understood = cast("dict[str, Any]", intent).get("region") if isinstance(intent, dict) else None
    return short(note.content.get("subtask")) or short(understood)
