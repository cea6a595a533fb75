"""What is drawn into the picture at peak force is where the stored camera saw it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording
from carecontact.report.miss import drawn_svg, is_hidden
from carecontact.report.moment import (
    EARLIER_WIDTH,
    WIDTH,
    Moment,
    peak_moment,
    peak_svg,
    place_notes,
    place_text,
    region_outline,
)
from carecontact.report.sections.trials import WITHOUT_HAND, peak_frame
from carecontact.report.trial_page import write_trial_page
from carecontact.scoring import score_recording
from tests.report.synthetic import CONTACT, FORCE_N, MIDDLE, RADIUS_M, make_recording, whole_trial
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


def test_a_press_outside_the_outline_and_away_from_the_tip_is_named() -> None:
    """Its cells lie within 10 mm across; another part of the tool presses 30 mm from them, and they feel nothing."""
    recording, moment = of_the_mitt(), moment_of()
    recording.arrays["scorer/cell_press_ns"][:] = 0
    beside = moment.centroid_in_region + [0.0, 0.04, 0.0]
    moved = replace(moment, centroid_in_region=beside, centroid_in_world=CONTACT + [0.0, 0.04, 0.0])
    wording = place_text(recording, moved)
    assert "30 mm toward the hand and 40 mm across from the middle" in wording
    assert wording.endswith("outside the region's outline: 30 mm from the nearest of its cells")
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


# A contact that the stored picture does not show is drawn from the stored skin, without the hand.

DOWN = [0.0, 1.0, 0.0, 0.0]
"""Quaternion of a tool that points down."""


def seen_from(offset_m: tuple[float, float, float], quat: list[float] = DOWN) -> tuple[Recording, Moment]:
    """A press from above with the camera at this place relative to the contact."""
    recording = whole_trial()
    pose = recording["scorer/pose_tcp_in_world"].copy()
    pose[:, 3:] = quat
    camera = recording["report/peak_pose_camera_in_world"].copy()
    camera[:3] = CONTACT + offset_m
    arrays = {**recording.arrays, "scorer/pose_tcp_in_world": pose, "report/peak_pose_camera_in_world": camera}
    recording = replace(recording, arrays=arrays)
    moment = peak_moment(recording)
    assert moment is not None
    return recording, moment


def test_the_hand_and_the_limb_hide_a_contact() -> None:
    assert not is_hidden(*seen_from((0.2, 0.0, 0.15))), "from the side, nothing is before the contact"
    assert is_hidden(*seen_from((0.0, 0.0, 0.3))), "the hand is above its tip"
    level = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    assert not is_hidden(*seen_from((0.0, 0.0, 0.3), level)), "a level hand is not"
    assert is_hidden(*seen_from((0.0, -0.2, -0.2))), "the limb is between"
    recording, moment = seen_from((0.0, 0.0, 0.3))
    bare = {name: of for name, of in recording.arrays.items() if name != "report/skin_in_world"}
    assert not is_hidden(replace(recording, arrays=bare), moment)
    assert drawn_svg(replace(recording, arrays=bare), moment, title="t") is None


def test_the_drawing_has_the_force_in_its_middle_and_the_tip() -> None:
    recording, moment = seen_from((0.0, 0.0, 0.3))
    header = recording.header.model_copy(update={"embodiment": "panda-mitt"})
    svg = drawn_svg(replace(recording, header=header), moment, title="a <title>") or ""
    assert 'aria-label="a &lt;title&gt;"' in svg
    (x, y), *_ = re.findall(r'class="head" points="([\d.]+),([\d.]+)', svg)
    assert (float(x), float(y)) == (pytest.approx(230, abs=1), pytest.approx(150, abs=1))
    assert svg.count('class="tip"') == svg.count('class="tool"') == 1
    unknown = drawn_svg(recording, moment, title="t") or ""
    assert unknown.count('class="tip"') == 0, "the tip of another robot is unknown"


def test_pages_show_it_only_where_the_picture_does_not(tmp_path: Path) -> None:
    for offset, hidden in (((0.0, 0.0, 0.3), True), ((0.2, 0.0, 0.15), False)):
        recording, _ = seen_from(offset)
        score = score_recording(recording)
        frame = peak_frame(score, recording)
        assert frame is not None
        assert (WITHOUT_HAND in frame.svg) is hidden
        page = write_trial_page(tmp_path, recording, score).read_text()
        assert (WITHOUT_HAND in page) is ("Half transparent: the tip" in page) is hidden


def test_the_outline_leaves_out_cells_on_the_far_side() -> None:
    """Of cells all round the limb, those that a viewer above sees reach 0.04 m to each side, and none lies below."""
    recording, moment = seen_from((0.0, 0.0, 0.3))
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    cells = [(u, RADIUS_M * np.cos(w), RADIUS_M * np.sin(w)) for u in (-0.1, 0.1) for w in angles]
    arrays = {**recording.arrays, "scorer/cell_in_region": np.array(cells, "f4")}
    seen: list[np.ndarray] = []

    def project(points: np.ndarray) -> np.ndarray:
        seen.append(points)
        return points[:, :2]

    region_outline(Recording.trusted(recording.header, arrays), moment.index, project, CONTACT + [0.0, 0.0, 9.0])
    (shown,) = seen
    assert len(shown) == 22
    assert (shown[:, 2] > MIDDLE[2]).all()
