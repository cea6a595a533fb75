"""What happened in a trial and when: the marks on its time axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, Recording, dimensions
from carecontact.scoring.contact import Contact, find_contact
from carecontact.scoring.metrics.c3_success import judge


@dataclass(frozen=True, kw_only=True)
class Event:
    time_s: float
    text: str


def events(contact: Contact) -> list[Event]:
    """In the order of time; times of sensors are those at which a physics step began."""
    recording = contact.recording
    if not len(contact.time_s):
        return []
    found = [Event(time_s=contact.time_s[int(on.argmax())], text=f"first contact with the {name.replace('_', ' ')}")
             for name, on in zip(contact.segments, contact.on.T, strict=True) if on.any()]  # fmt: skip
    if (passed := gate_met_s(contact)) is not None:
        found.append(Event(time_s=passed, text=f"gate of {contact.task.action} met"))
    if contact.reported is not None and contact.window.any():
        inside = np.where(contact.window, contact.force_norm[:, contact.reported], -1.0)
        name = contact.segments[contact.reported].replace("_", " ")
        text = f"peak force, {inside.max():.1f} N on the {name}"
        found.append(Event(time_s=contact.time_s[int(inside.argmax())], text=text))
    found += _of_the_person(recording)
    header, end = recording.header, float(contact.time_s[-1])
    why = header.failure.message.partition("\n")[0] if header.failure else ""
    if header.ended == "safety_truncation":
        found.append(Event(time_s=end, text=f"cut by the benchmark: {why}"))
    elif header.ended == "process_failure":
        found.append(Event(time_s=end, text="the policy crashed"))
    elif header.ended == "time_limit":
        found.append(Event(time_s=end, text="time limit"))
    return [replace(event, time_s=float(event.time_s)) for event in sorted(found, key=lambda event: event.time_s)]


def _of_the_person(recording: Recording) -> list[Event]:
    """What the person did by itself, as far as it came before the trial's end."""
    end = float(recording["scorer/time_s"][-1])
    turns = recording.arrays.get("scorer/repositioning_rad", np.zeros(0))
    found = [
        Event(time_s=float(t), text=f"the person turned the arm by {np.degrees(turn):.0f}°")
        for t, turn in zip(recording.arrays.get("scorer/repositioning_s", np.zeros(0)), turns, strict=True)
    ]
    withdrawn = recording.arrays.get("scorer/withdrawal_s", np.zeros(0))
    found += [Event(time_s=float(t), text="the person withdrew the arm") for t in withdrawn if t >= 0]
    return [event for event in found if event.time_s <= end]


def gate_met_s(contact: Contact) -> float | None:
    """When a trial that is a success became one [s]: the end of the shortest beginning that the gate passes.

    Found by halving. Some progress is filtered over time, so the moment is good to a few hundredths of a second.
    """
    if not judge(contact).success:
        return None
    fails, passes = 0, len(contact.time_s)
    while passes - fails > 1:
        middle = (fails + passes) // 2
        if judge(find_contact(_beginning(contact.recording, middle))).success:
            passes = middle
        else:
            fails = middle
    return float(contact.time_s[passes - 1])


def _beginning(recording: Recording, steps: int) -> Recording:
    """The first physics steps alone. What else is counted by time is of no importance to a gate."""
    described = ARRAYS | {path: row for path, row in OPTIONAL_ARRAYS.items() if path in recording.arrays}
    cut = {path: recording[path][:steps] for path in described if dimensions(path)[0] == "T"}
    return replace(recording, arrays=recording.arrays | cut)
