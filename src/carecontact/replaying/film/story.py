"""The data that a video shows beside its pictures: traces, events and the pressure on the region, from the recording
alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.recording.reason import ended_text
from carecontact.recording.schema import Recording
from carecontact.regions import REGIONS, Tube
from carecontact.reports.page.force_trace import ForceTrace, force_trace
from carecontact.reports.trial.events import TOLD_ENDS, Event, events
from carecontact.scoring import score_recording
from carecontact.scoring.contact import Contact, find_contact

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RegionMap:
    """Pressure on the declared cells of a soft region, unrolled onto a plane."""

    places_m: F64
    """(C, 2) along the region and around it"""
    period_s: F64
    """(P,) end of each period"""
    pressure_kpa: F64
    """(P, C) mean over the period"""
    toward: str
    """Words for the direction in which the first coordinate grows."""

    def at(self, time_s: float) -> tuple[F64, npt.NDArray[np.bool_]]:
        """Return the (C,) pressure [kPa] in the control period at a time, and (C,) which cells were touched until
        then."""
        row = int(np.searchsorted(self.period_s, time_s - 1e-9))
        if row >= len(self.period_s):
            return np.zeros(len(self.places_m)), np.any(self.pressure_kpa > 0, axis=0)
        return self.pressure_kpa[row], np.any(self.pressure_kpa[: row + 1] > 0, axis=0)


@dataclass(frozen=True, kw_only=True)
class Story:
    title: str
    prompt: str
    about: str
    """Policy, seed and protocol."""
    segment: str
    region: str
    trace: ForceTrace
    depth_s: F64
    """(P,)"""
    depth_mm: F64
    """(P,) largest indentation of the named region"""
    duration_s: float
    events: list[Event]
    map: RegionMap | None
    """None where the region is rigid."""
    verdict: str


def story_of(recording: Recording) -> Story:
    """Raises what ``score_recording`` raises."""
    header, spec = recording.header, recording.header.spec
    task, score = spec.protocol.task(spec.task_id), score_recording(recording)
    trace = force_trace(recording, score)
    column = header.regions.index(task.region)
    duration = len(recording["scorer/time_s"]) * spec.protocol.physics.dt_s
    passed = "safety-gated" if score.safety_gated else "region-correct" if score.region_correct else "success"
    return Story(
        title=spec.trial_id,
        prompt=task.prompt,
        about=f"{spec.policy} · seed {spec.seed} · {spec.protocol.title}",
        segment=REGIONS[task.region].segment.replace("_", " "),
        region=task.region.replace("_", " "),
        trace=trace,
        depth_s=recording["scorer/period_time_s"],
        depth_mm=1000.0 * recording["scorer/indentation_m"][:, column],
        duration_s=duration,
        events=_events(find_contact(recording), duration),
        map=_map(recording, task.region),
        verdict=f"{ended_text(header.ended)}: {passed if score.c3_success else 'no success'}",
    )


def _events(contact: Contact, duration_s: float) -> list[Event]:
    """Return those of the trial's page, between the start and how the trial ended."""
    ended = contact.recording.header.ended
    found = [Event(time_s=0.0, text="start"), *events(contact)]
    if ended not in TOLD_ENDS:
        found.append(Event(time_s=duration_s, text=ended_text(ended)))
    return found


def _map(recording: Recording, region: str) -> RegionMap | None:
    arrays = recording.arrays
    if "scorer/cell_press_ns" not in arrays or not len(arrays["scorer/period_time_s"]):
        return None
    centre, area = arrays["scorer/cell_in_region"].astype(float), arrays["scorer/cell_area_m2"].astype(float)
    shape, across = REGIONS[region].shape, centre[:, 1]
    if isinstance(shape, Tube):
        radius = recording["scorer/region_size_m"][recording.header.regions.index(region), 1]
        across = radius * np.arctan2(centre[:, 1], centre[:, 2])
    period = arrays["scorer/period_time_s"]
    length = np.diff(period, prepend=0.0)
    pressure = arrays["scorer/cell_press_ns"] / np.maximum(length, 1e-9)[:, None] / area / 1000.0
    return RegionMap(
        places_m=np.stack([centre[:, 0], across], 1), period_s=period, pressure_kpa=pressure,
        toward="to the hand" if isinstance(shape, Tube) else "to the head",
    )  # fmt: skip
