"""What a film tells, against the recording that it is of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carecontact.recording import Recording
from carecontact.replaying.film.panel import MARGIN, WIDTH, Panel
from carecontact.replaying.film.story import story_of


def test_events_are_where_the_recording_has_them(pressed: Recording) -> None:
    story = story_of(pressed)
    assert [event.text.split()[0] for event in story.events] == ["start", "first", "peak", "gate", "done"]
    force = np.linalg.norm(pressed["scorer/force_human_from_robot_in_world"], axis=2).max(1)
    touched = pressed["scorer/time_s"][force > 0.2]
    assert abs(story.events[1].time_s - touched[0]) < 0.1
    assert story.events[-1].time_s == story.duration_s
    assert story.trace.peak_n is not None
    assert f"peak force, {story.trace.peak_n:.1f} N on the right forearm" in [event.text for event in story.events]


def test_the_map_has_the_pressure_that_the_cells_felt(pressed: Recording) -> None:
    cells = story_of(pressed).map
    assert cells is not None
    end = float(pressed["scorer/period_time_s"][-1])
    pressure, touched = cells.at(end)
    felt = 1000 * pressure @ pressed["scorer/cell_area_m2"]
    column = pressed.header.segments.index("right_forearm")
    last = pressed["scorer/time_s"] > pressed["scorer/period_time_s"][-2] - 1e-9
    assert np.isclose(felt, pressed["scorer/normal_force"][last, column].mean(), rtol=0.02)
    assert (touched >= (pressure > 0)).all()
    before, nothing = cells.at(0.5)
    assert not before.any()
    assert not nothing.any()


def test_the_heading_names_the_level_of_the_protocol(pressed: Recording) -> None:
    header = pressed.header
    protocol = header.spec.protocol.model_copy(update={"level": "L3"})
    levelled = replace(
        pressed, header=header.model_copy(update={"spec": header.spec.model_copy(update={"protocol": protocol})})
    )
    assert story_of(levelled).about.endswith(f"{protocol.id} L3")


def test_a_long_subtitle_stays_inside_the_frame(pressed: Recording) -> None:
    story = story_of(pressed)
    bare = Panel(replace(story, about=""), note="").at(0.0)
    words = " ".join(["person.alive.breathing.abdomen_m=[0.015, 0.015]"] * 6)
    long = Panel(replace(story, about=words), note="").at(0.0)
    written = np.flatnonzero((long != bare).any(axis=(0, 2)))
    assert MARGIN - 2 <= written.min()
    assert written.max() < WIDTH - MARGIN / 2, "the ellipsis may stand in the margin"
