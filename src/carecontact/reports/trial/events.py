"""What happened in a trial and when: the marks on its time axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carecontact.recording.reason import reason_of
from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, EndReason, Recording, dimensions
from carecontact.scoring.contact import Contact, find_contact
from carecontact.scoring.metrics.c3_success import judge

TENSE_S = 0.1
"""Time before the recorded onset of a movement at which the person's muscles begin to tense [s] (RISE in
``kernel/c/life.c``)."""
TOLD_ENDS: dict[EndReason, str] = {
    "safety_truncation": "cut by the benchmark",
    "process_failure": "the policy crashed",
    "time_limit": "time limit",
}
"""The ends of a trial that are events. A policy that is done, and a harness that fails, do nothing to the person."""


@dataclass(frozen=True, kw_only=True)
class Event:
    time_s: float
    text: str


def events(contact: Contact) -> list[Event]:
    """Return the events of a trial in the order of time. A sensor's time is that at which its physics step began."""
    header = contact.recording.header
    if not len(contact.time_s):
        return []
    found = _faint(contact) if contact.reported is None else []
    found += [Event(time_s=contact.time_s[int(on.argmax())], text=f"first contact with the {name.replace('_', ' ')}")
             for name, on in zip(contact.segments, contact.on.T, strict=True) if on.any()]  # fmt: skip
    if (passed := gate_met_s(contact)) is not None:
        found.append(Event(time_s=passed, text=f"gate of {contact.task.action} met"))
    if contact.reported is not None and contact.window.any():
        inside = np.where(contact.window, contact.force_norm[:, contact.reported], -1.0)
        name = contact.segments[contact.reported].replace("_", " ")
        text = f"peak force, {inside.max():.1f} N on the {name}"
        found.append(Event(time_s=contact.time_s[int(inside.argmax())], text=text))
    found += _of_the_person(contact.recording)
    if header.ended in TOLD_ENDS:
        cut = header.failure if header.ended == "safety_truncation" else None
        why = "" if cut is None else f": {reason_of(cut)}"
        found.append(Event(time_s=contact.time_s[-1], text=f"{TOLD_ENDS[header.ended]}{why}"))
    return [replace(event, time_s=float(event.time_s)) for event in sorted(found, key=lambda event: event.time_s)]


def _faint(contact: Contact) -> list[Event]:
    """Return when a press began that was too light to count as contact, and its largest force."""
    felt = (contact.force_norm > 0).any(axis=1)
    if not felt.any():
        return []
    step, segment = np.unravel_index(int(contact.force_norm.argmax()), contact.force_norm.shape)
    name, least = contact.segments[int(segment)].replace("_", " "), contact.protocol.contact.on_n
    largest = f"largest force, {contact.force_norm[step, segment]:.1f} N on the {name}"
    return [
        Event(time_s=contact.time_s[int(felt.argmax())], text=f"first force, below the {least:g} N that contact needs"),
        Event(time_s=contact.time_s[int(step)], text=largest),
    ]


def _of_the_person(recording: Recording) -> list[Event]:
    """Return what the person did by itself, as far as it came before the trial's end."""
    end = float(recording["scorer/time_s"][-1])
    times, turns = (recording.arrays.get(f"scorer/repositioning_{unit}", np.zeros(0)) for unit in ("s", "rad"))
    found = [
        Event(time_s=max(0.0, float(time_s) - TENSE_S), text=f"the person begins to turn the arm by {_turn_text(turn)}")
        for time_s, turn in zip(times, turns, strict=True)
    ]
    withdrawn = recording.arrays.get("scorer/withdrawal_s", np.zeros(0))
    found += [Event(time_s=float(t), text="the person withdraws the arm") for t in withdrawn if t >= 0]
    return [event for event in found if event.time_s <= end]


def _turn_text(turn_rad: float) -> str:
    """Size and direction of a turn of the shoulder's abduction, in words."""
    return f"{abs(np.degrees(turn_rad)):.0f}° {'away from' if turn_rad > 0 else 'toward'} the trunk"


def gate_met_s(contact: Contact) -> float | None:
    """Return when a trial that is a success became one [s]: the end of a beginning of the trial that the gate passes,
    while the beginning that is one physics step shorter does not pass.

    Found by halving the trial. Where a gate has an upper end, a trial can pass, fail and pass again; then this is one
    of the moments at which it began to pass. Some progress is filtered over time, so the moment is exact to a few
    hundredths of a second.
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
    """Return the recording of the first physics steps alone. Arrays over other units of time stay whole, since no gate
    reads them."""
    described = ARRAYS | {path: row for path, row in OPTIONAL_ARRAYS.items() if path in recording.arrays}
    cut = {path: recording[path][:steps] for path in described if dimensions(path)[0] == "T"}
    return replace(recording, arrays={**recording.arrays, **cut})
