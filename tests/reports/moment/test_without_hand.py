"""A contact that the stored picture does not show is drawn from the stored skin, without the hand."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.recording.schema import Recording
from carecontact.reports.moment.moment import Moment, peak_moment
from carecontact.reports.moment.picture import region_outline
from carecontact.reports.moment.without_hand import drawn_svg, is_hidden
from carecontact.reports.page.sections.frames import WITHOUT_HAND, peak_frame
from carecontact.reports.trial.page import write_trial_page
from carecontact.scoring import score_recording
from tests.reports.synthetic_trial import CONTACT, MIDDLE, RADIUS_M, whole_trial

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
    assert unknown.count('class="tip"') == 0, "nobody knows the tip of another robot"


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
