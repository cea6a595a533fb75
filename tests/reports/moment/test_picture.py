"""What is drawn into the picture at peak force is where the stored camera saw it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording
from carecontact.reports.moment.moment import Moment, peak_moment
from carecontact.reports.moment.picture import EARLIER_WIDTH, WIDTH, peak_svg
from carecontact.reports.moment.place import place_notes, place_text
from tests.reports.synthetic_run import make_recording
from tests.reports.synthetic_trial import CONTACT, FORCE_N, whole_trial
from tests.scoring.synthetic import writable


def moment_of(**changes: bool) -> Moment:
    found = peak_moment(whole_trial(**changes))
    assert found is not None
    return found


def of_the_mitt() -> Recording:
    """Of a robot whose tool's tip is known."""
    recording = whole_trial()
    return writable(replace(recording, header=recording.header.model_copy(update={"embodiment": "panda-mitt"})))


def test_where_and_how_hard_and_how_deep() -> None:
    recording, moment = whole_trial(), moment_of()
    assert moment.force_n == pytest.approx(FORCE_N)
    assert moment.centroid_in_world == pytest.approx(CONTACT)
    assert moment.depth_m == pytest.approx(0.006)
    assert moment.outward_in_world == pytest.approx([0, 0, 1])
    assert place_text(recording, moment) == (
        "the right forearm, 30 mm toward the hand from the middle of the region, which is 260 mm long, "
        "inside the region's outline"
    )
    assert moment.deepest == (pytest.approx(0.006), pytest.approx(moment.time_s, abs=0.1))
    assert place_notes(of_the_mitt(), moment) == []
    assert peak_moment(whole_trial(touched=False)) is None


def test_a_press_outside_the_outline_and_away_from_the_tip_is_told() -> None:
    """Its cells lie within 10 mm across; another part of the tool presses 30 mm from them, and they feel nothing."""
    recording, moment = of_the_mitt(), moment_of()
    recording.arrays["scorer/cell_press_ns"][:] = 0
    beside = moment.centroid_in_region + [0.0, 0.04, 0.0]
    moved = replace(moment, centroid_in_region=beside, centroid_in_world=CONTACT + [0.0, 0.04, 0.0])
    told = place_text(recording, moved)
    assert "30 mm toward the hand and 40 mm across from the middle" in told
    assert told.endswith("outside the region's outline: 30 mm from the nearest of its cells")
    away, felt = place_notes(recording, moved)
    assert away.startswith("The force acts 40 mm from the tip of the tool: another part")
    assert felt == "The cells inside the region's outline felt 0\N{NO-BREAK SPACE}% of this force."


def test_a_press_beside_the_region_is_named_and_has_no_depth() -> None:
    recording = make_recording("T1", 0, {"pelvis": np.full(500, 7.0)}, duration_s=1)
    moment = peak_moment(recording)
    assert moment is not None
    assert (place_text(recording, moment), moment.depth_m) == ("the pelvis, not the named region", None)


def test_a_press_along_the_line_of_sight_is_a_cross_at_the_contact() -> None:
    """The camera looks straight down, and so does the force."""
    svg = peak_svg(whole_trial(), moment_of(), title="t") or ""
    assert 'class="arrow"' in svg
    assert 'class="head"' not in svg
    (x, y) = re.findall(r'<circle class="arrow" cx="([\d.]+)" cy="([\d.]+)"', svg)[0]
    # The contact is 20 mm to the left of the optical axis, 0.3 m away; the crop begins where it can.
    u, v = 320 - 400 * 0.02 / 0.3, 180.0
    left, top = int(u - WIDTH / 2), int(v - 0.55 * 260)
    assert (float(x), float(y)) == (pytest.approx(u - left, abs=1.1), pytest.approx(v - top, abs=1.1))
    assert "20.0 N" in svg
    assert 'class="outline"' in svg


def test_a_press_across_the_line_of_sight_is_an_arrow_that_ends_at_the_contact() -> None:
    moment = replace(moment_of(), force_in_world=np.array([FORCE_N, 0.0, 0.0]))
    svg = peak_svg(whole_trial(), moment, title="t") or ""
    tip = re.findall(r'<polygon class="head" points="([\d.]+),([\d.]+) ', svg)[0]
    start = re.findall(r'<path class="arrow" d="M([\d.]+) ([\d.]+)L', svg)[0]
    assert float(tip[0]) - float(start[0]) == pytest.approx(400 * 0.044 / 0.3, abs=0.3), "2.2 mm for 1 N"
    assert float(tip[1]) == pytest.approx(float(start[1]), abs=0.2)


def test_an_earlier_recording_is_cropped_to_the_middle_and_nothing_is_drawn_in() -> None:
    recording = whole_trial()
    for name in ("report/peak_pose_camera_in_world", "report/peak_focal_px"):
        del recording.arrays[name]
    svg = peak_svg(recording, moment_of(), title="t") or ""
    assert f'viewBox="0 0 {EARLIER_WIDTH} ' in svg
    assert "arrow" not in svg
    recording.arrays["report/peak_rgb"] = np.zeros((4, 4), np.uint8)
    with pytest.raises(RecordingError, match="stored frame has shape"):
        peak_svg(recording, None, title="t")
    del recording.arrays["report/peak_rgb"]
    assert peak_svg(recording, None, title="t") is None
