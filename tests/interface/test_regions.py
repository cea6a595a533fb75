"""Every registered region: its names exist elsewhere, and its frame can be found on every segment of a body."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
import pytest

from carecontact.errors import ConfigError
from carecontact.human.body import Body
from carecontact.human.library import load_body
from carecontact.human.skeleton import rigid_frame
from carecontact.interface import regions
from carecontact.interface.body_view import JOINT_DEPTH_M, LANDMARK
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS, LimbSight, Region, TrunkSight, Tube, all_regions
from carecontact.policies.language.backend import ACTIONS
from carecontact.recording.notes import JOINTS
from carecontact.recording.schema import SEGMENTS

WRIST = LimbSight(joints=("elbow", "wrist"))
TUBE = Tube(span=(0.1, 0.9), closed_by=("upper_arm", "hand"))


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


def test_every_joint_can_be_seen_and_every_segment_is_a_bodys(body: Body) -> None:
    assert set(LANDMARK) == {f"{side} {joint}" for side in ("left", "right") for joint in regions.JOINTS}
    assert {joint for joint in JOINT_DEPTH_M} == set(regions.JOINTS)
    assert set(SEGMENTS) < set(body.segments)
    assert set(regions.LIMB_PARTS) == {name.partition("_")[2] for name in body.segments if name.startswith("left_")}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"segment": "right_hnad"}, "Region.segment: 'right_hnad' is unknown; valid: pelvis, .*, left_foot"),
        ({"neighbourhood": ("right_hand", "right_hnad")}, "Region.neighbourhood: 'right_hnad' is unknown; valid: pel"),
        ({"neighbourhood": "right_hand"}, "Region.neighbourhood: expected a tuple of names, got 'right_hand'; valid: "),
        ({"neighbourhood": ()}, r"Region.neighbourhood: expected a tuple of names, got \(\); valid: "),
        ({"words": "palm"}, "Region.words: expected a tuple of texts, got 'palm'"),
        ({"segment": "head", "sight": WRIST}, "Region.sight: LimbSight is for a limb, and head has no side"),
        ({"segment": "head", "shape": TUBE}, "Region.shape: Tube is for a limb, and head has no side"),
    ],
)
def test_a_row_with_a_wrong_field_is_refused(changed: dict[str, Any], message: str) -> None:
    fields = {"segment": "right_hand", "neighbourhood": ("right_hand",)} | changed
    with pytest.raises(ConfigError, match=f"^{message}"):
        Region(**fields)


@pytest.mark.parametrize("sight", [LimbSight, partial(TrunkSight, middle=0.5, length=0.5)])
@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (("wrst", "elbow"), "'wrst' is unknown; valid: shoulder, elbow, wrist, hip, knee, ankle"),
        (("wrist",), "expected two different names, got wrist; valid: "),
        (("wrist", "wrist"), "expected two different names, got wrist, wrist; valid: "),
        ("wrist", "expected a tuple of names, got 'wrist'; valid: "),
    ],
)
def test_sight_needs_two_joints(sight: Any, joints: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"^(Limb|Trunk)Sight\.joints: {message}"):
        sight(joints=joints)


def test_a_tube_is_closed_by_two_parts_of_a_limb() -> None:
    with pytest.raises(ConfigError, match=r"^Tube\.closed_by: 'pelvis' is unknown; valid: clavicle, .*foot"):
        Tube(span=(0.1, 0.9), closed_by=("pelvis", "shank"))


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
