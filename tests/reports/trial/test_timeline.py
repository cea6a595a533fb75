"""The charts over time name the peak, a safety gate that is out of sight, and more than one value on each axis."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.recording.schema import Recording
from carecontact.reports.page.force_trace import force_trace
from carecontact.reports.trial.paths import paths
from carecontact.reports.trial.timeline import panels_of, ticks, timeline_svg
from carecontact.scoring import score_recording
from tests.reports.synthetic_trial import whole_trial


def drawn(recording: Recording) -> str:
    trace = force_trace(recording, score_recording(recording))
    return timeline_svg(panels_of(recording, trace, paths(recording)), trace, [], [])


def pressed_with(share: float) -> Recording:
    """Of the 20 N of the synthetic trial, whose safety gate is 35 N."""
    recording = whole_trial()
    recording.arrays["scorer/force_human_from_robot_in_world"][:] *= share
    recording.arrays["scorer/normal_force"][:] *= share
    return recording


@pytest.mark.parametrize(("share", "line"), [(1.0, 'class="gate"'), (0.2, "↑ safety gate of the right forearm 35 N")])
def test_the_force_chart_names_its_peak_and_the_safety_gate(share: float, line: str) -> None:
    svg = drawn(pressed_with(share))
    assert f">{20 * share:.1f} N</text>" in svg
    assert line in svg
    assert "safety gate of the right forearm 35 N" in svg


@given(st.floats(-300, 300), st.floats(1e-3, 600))
def test_every_axis_has_two_values_or_more(low: float, span: float) -> None:
    found = ticks(low, low + span)
    assert 2 <= len(found) <= 7
    assert all(low <= value <= low + span for value in found)
