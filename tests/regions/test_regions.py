"""Every registered region: its names exist elsewhere, and its frame can be found on every segment of a body."""

from __future__ import annotations

import re

import numpy as np
import pytest

from carecontact.policies.language.rules import ACTIONS
from carecontact.recording.perception import JOINTS
from carecontact.recording.schema import SEGMENTS
from carecontact.regions import REGIONS, STANDARD_REGIONS, Region, all_regions
from carecontact.sight import LANDMARK
from carecontact.world.human.body import Body
from carecontact.world.human.library import load_body
from carecontact.world.human.region_frame import rigid_frame


def test_the_standard_regions_are_soft_and_come_first() -> None:
    assert all(REGIONS[name].soft for name in STANDARD_REGIONS)
    assert all_regions()[:3] == STANDARD_REGIONS
    assert sorted(all_regions()) == sorted(REGIONS)


@pytest.mark.parametrize("name", all_regions())
def test_a_row_names_what_exists(name: str) -> None:
    row = REGIONS[name]
    assert row.segment in SEGMENTS
    assert row.segment in row.neighbourhood
    assert set(row.neighbourhood) <= set(SEGMENTS)
    assert set(row.sight_joints) <= set(JOINTS)
    assert set(row.sight_joints) <= set(LANDMARK)
    assert row.sided == row.segment.startswith(("right_", "left_"))


def test_no_word_stands_for_two_things() -> None:
    """A region's word inside a phrase for an action would make every such instruction ambiguous."""
    words = [word for name in all_regions() for word in REGIONS[name].words]
    assert len(set(words)) == len(words)
    phrases = [phrase for several in ACTIONS.values() for phrase in several]
    assert not [(w, p) for w in words for p in phrases if re.search(rf"\b{re.escape(w)}\b", p)]


@pytest.fixture(scope="module")
def body() -> Body:
    return load_body("man-adult")


@pytest.mark.parametrize("segment", SEGMENTS)
def test_a_rigid_region_can_be_any_segment(segment: str, body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    list(REGIONS)
    monkeypatch.setitem(REGIONS._rows, "probe", Region(segment=segment, neighbourhood=(segment,)))
    frame = rigid_frame(body, "probe")
    np.testing.assert_allclose(frame.axes.T @ frame.axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.axes) == pytest.approx(1.0)
    assert (frame.size_m > 0.02).all()
    assert (frame.size_m < 0.6).all()
    points = body.vertices_of(segment)
    assert np.linalg.norm(frame.origin - points.mean(0)) < 0.15
