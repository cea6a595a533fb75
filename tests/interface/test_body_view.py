from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import ContractError
from carecontact.interface.body_view import (
    COLUMN_RADIUS_M,
    HALF_SCRUB_M,
    LANDMARK,
    MIN_REGION_M,
    PerceptionFailure,
    _around,
    _column,
    free_from,
    joint_centre,
    region_from_observation,
)
from carecontact.interface.observation import Observation
from carecontact.interface.regions import REGIONS, LimbSight, Region, TrunkSight
from tests.interface.lying_person import HEIGHT, LIMB_RADIUS, TRUNK_RADIUS, WIDTH, Person, change_view, observe

PIXEL_M = 2.0 / 330


def ahead(region: str, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the state machine takes the joints to be when the key points are at these places."""
    sight = REGIONS[region].sight
    assert sight is not None
    shares = sight.ahead
    return first + shares[0] * (second - first), second + shares[1] * (second - first)


def test_forearm(observation: Observation, person: Person) -> None:
    forearm = region_from_observation(observation, "forearm")
    middle = (person.elbow + person.wrist) / 2
    np.testing.assert_allclose(forearm.centre_m, [*middle[:2], 2 * LIMB_RADIUS], atol=0.006)
    assert forearm.axis @ person.arm_direction > np.cos(np.radians(2))
    assert forearm.normal @ [0, 0, 1] > np.cos(np.radians(2))
    assert forearm.half_length_m == pytest.approx(0.13, abs=0.008)
    assert forearm.radius_m == pytest.approx(LIMB_RADIUS, abs=PIXEL_M)
    assert forearm.support_height_m == pytest.approx(0.0, abs=1e-6)


def test_upper_arm_starts_below_the_shoulder(observation: Observation, person: Person) -> None:
    upper_arm = region_from_observation(observation, "upper_arm")
    start, end = ahead("upper_arm", person.shoulder, person.elbow)
    sight = REGIONS["upper_arm"].sight
    assert isinstance(sight, LimbSight)
    middle = start + (1 + sight.free_from) / 2 * (end - start)
    np.testing.assert_allclose(upper_arm.centre_m, [*middle[:2], 2 * LIMB_RADIUS], atol=0.008)


def test_abdomen(observation: Observation, person: Person) -> None:
    abdomen = region_from_observation(observation, "abdomen")
    hips, neck = ahead("abdomen", person.hips, person.neck)
    sight = REGIONS["abdomen"].sight
    assert isinstance(sight, TrunkSight)
    middle = hips + sight.middle * (neck - hips)
    np.testing.assert_allclose(abdomen.centre_m[:2], middle[:2], atol=0.01)
    assert abdomen.centre_m[2] == pytest.approx(0.10 + TRUNK_RADIUS, abs=0.003)
    assert abdomen.axis @ [1, 0, 0] > np.cos(np.radians(3))
    assert abdomen.radius_m == pytest.approx(TRUNK_RADIUS, abs=0.012)


def test_a_rising_forearm_has_a_rising_axis() -> None:
    person = Person(wrist_rise_m=0.06)
    forearm = region_from_observation(observe(person), "forearm")
    along = (person.wrist - person.elbow) / np.linalg.norm(person.wrist - person.elbow)
    assert forearm.axis @ along > np.cos(np.radians(3))
    assert abs(forearm.axis @ forearm.normal) < 1e-9
    # The surface between the joints is the cylinder's top line.
    for distance in (-0.06, 0.0, 0.06):
        assert abs(person.clearance(forearm.surface(distance)[None])[0]) < 0.005


@settings(max_examples=8, deadline=None)
@given(st.floats(35, 75))
def test_any_arm_angle(abduction_deg: float) -> None:
    person = Person(abduction_deg=abduction_deg)
    forearm = region_from_observation(observe(person), "forearm")
    assert np.linalg.norm(forearm.centre_m[:2] - (person.elbow + person.wrist)[:2] / 2) < 0.01


def test_key_points_beside_the_limb_are_moved_onto_it(observation: Observation, person: Person) -> None:
    view = observation.cameras["overhead"]
    assert view.landmarks_in_base is not None
    across = np.cross([0, 0, 1], person.arm_direction)
    strayed = view.landmarks_in_base + (0.02 * across).astype(np.float32)
    forearm = region_from_observation(change_view(observation, landmarks_in_base=strayed), "forearm")
    assert abs((forearm.centre_m - person.elbow) @ across) < 0.004
    lost = view.landmarks_in_base + (0.06 * across).astype(np.float32)
    with pytest.raises(PerceptionFailure, match="miss the forearm"):
        region_from_observation(change_view(observation, landmarks_in_base=lost), "forearm")


def test_no_person_there() -> None:
    with pytest.raises(PerceptionFailure, match="nobody was found"):
        region_from_observation(observe(None), "forearm")


@pytest.mark.parametrize(
    ("name", "column", "value", "reason"),
    [("right wrist", 2, 0.1, "right wrist is hidden"), ("right elbow", 2, 0.3, "right elbow is hidden")],
)
def test_a_hidden_joint(observation: Observation, name: str, column: int, value: float, reason: str) -> None:
    landmarks = np.array(observation.cameras["overhead"].landmarks)
    landmarks[LANDMARK[name], column] = value
    with pytest.raises(PerceptionFailure, match=reason):
        region_from_observation(change_view(observation, landmarks=landmarks), "forearm")


def test_a_joint_without_depth(observation: Observation) -> None:
    surface = np.array(observation.cameras["overhead"].landmarks_in_base)
    surface[LANDMARK["right wrist"]] = np.nan
    with pytest.raises(PerceptionFailure, match="right wrist has no depth"):
        region_from_observation(change_view(observation, landmarks_in_base=surface), "forearm")


@pytest.mark.parametrize(("length", "seen"), [(0.45, True), (0.65, False)])
def test_a_region_of_the_leg(length: float, seen: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shank is longer than a limb of the arm can be."""
    shank = Region(segment="left_shank", neighbourhood=("left_foot",), sight=LimbSight(joints=("knee", "ankle")))
    monkeypatch.setitem(REGIONS._rows, "left_shin", shank)
    person = Person(shoulder=np.array([0.75, -0.45, LIMB_RADIUS]))
    observation = observe(person)
    landmarks = np.array(observation.cameras["overhead"].landmarks)
    surface = np.array(observation.cameras["overhead"].landmarks_in_base)
    for leg, arm, share in (("left knee", "right wrist", length / 0.54), ("left ankle", "right shoulder", 0.0)):
        landmarks[LANDMARK[leg]] = landmarks[LANDMARK[arm]]
        surface[LANDMARK[leg]] = person.shoulder + share * (person.wrist - person.shoulder) + [0, 0, LIMB_RADIUS]
    leg = change_view(observation, landmarks=landmarks, landmarks_in_base=surface)
    if seen:
        found = region_from_observation(leg, "left_shin", side="left")
        assert found.half_length_m == pytest.approx(length / 2, abs=0.02)
        return
    with pytest.raises(PerceptionFailure, match=r"left left shin seems 0\.6\d m long, expected 0\.15 to 0\.6 m"):
        region_from_observation(leg, "left_shin", side="left")


def test_a_joint_without_a_key_point_is_a_failure_of_perception(observation: Observation) -> None:
    with pytest.raises(PerceptionFailure, match="no key point is named 'none knee'; valid: left shoulder, "):
        joint_centre(observation.cameras["overhead"], "none knee")


def test_an_absurd_skeleton(observation: Observation) -> None:
    surface = np.array(observation.cameras["overhead"].landmarks_in_base)
    surface[LANDMARK["right wrist"]] = surface[LANDMARK["right elbow"]] + 0.5
    with pytest.raises(PerceptionFailure, match=r"0\.8\d m long"):
        region_from_observation(change_view(observation, landmarks_in_base=surface), "forearm")


def test_too_few_points(observation: Observation) -> None:
    masks = dict(observation.cameras["overhead"].masks or {})
    masks["human"] = np.zeros((HEIGHT, WIDTH), bool)
    with pytest.raises(PerceptionFailure, match="no surface near the forearm"):
        region_from_observation(change_view(observation, masks=masks), "forearm")


def test_a_modality_that_was_not_asked_for(observation: Observation) -> None:
    with pytest.raises(ContractError, match="are needed"):
        region_from_observation(change_view(observation, masks=None), "forearm")


# The upper arm's region begins where a chest, as the camera sees it, leaves room for the hand.

SIGHT = REGIONS["upper_arm"].sight
assert isinstance(SIGHT, LimbSight)
START, END = np.array([0.0, 0.0, 0.08]), np.array([0.27, 0.0, 0.08])
PITCH_M = 0.004


def surface(low: tuple[float, float], high: tuple[float, float], height_m: float) -> np.ndarray:
    x, y = (np.arange(a, b, PITCH_M) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    return np.c_[grid, np.full(len(grid), height_m)]


def person(chest_until_m: float, chest_height_m: float) -> np.ndarray:
    """An arm 80 mm high, and beside it a chest up to a distance from the shoulder."""
    arm = surface((-0.05, -0.04), (0.33, 0.04), 0.08)
    return np.concatenate([arm, surface((-0.15, 0.05), (chest_until_m, 0.25), chest_height_m)])


def test_a_flat_or_distant_chest_changes_nothing() -> None:
    assert free_from(SIGHT, person(0.20, 0.10), START, END) == SIGHT.free_from
    assert free_from(SIGHT, person(-0.10, 0.20), START, END) == SIGHT.free_from


def test_a_high_chest_moves_the_region_until_half_a_scrub_is_free() -> None:
    """The hand's corners, 120 mm from the tool, meet a chest 50 mm beside the arm's line 109 mm farther along it."""
    share = free_from(SIGHT, person(0.07, 0.20), START, END)
    crowded_m = 0.07 + np.sqrt(0.12**2 - 0.05**2)
    length = END[0]
    middle = (1 + share) / 2 * length
    # A chest that only just reaches under the hand has too few points to count.
    assert crowded_m - 0.01 < middle < crowded_m + HALF_SCRUB_M + 0.005
    assert share > SIGHT.free_from


def test_some_of_the_arm_always_stays() -> None:
    share = free_from(SIGHT, person(0.33, 0.20), START, END)
    assert (1 - share) * END[0] == pytest.approx(MIN_REGION_M)


def test_a_forearm_has_no_trunk_beside_it() -> None:
    sight = REGIONS["forearm"].sight
    assert isinstance(sight, LimbSight)
    assert free_from(sight, person(0.33, 0.20), START, END) == 0.0


def test_a_column_over_a_line_is_that_of_the_points_around_the_line() -> None:
    """Points that no column can hold are left out before, which must change no bit."""
    rng = np.random.default_rng(0)
    person = rng.uniform([0.2, -0.3, 0.0], [0.8, 0.3, 0.3], (20_000, 3))
    for _ in range(20):
        start, end = rng.uniform([0.3, -0.2, 0.0], [0.7, 0.2, 0.1], (2, 3))
        near = _around(person, start, end, COLUMN_RADIUS_M)
        assert 0 < len(near) < len(person)
        for share in np.linspace(0, 1, 11):
            place = start + share * (end - start)
            np.testing.assert_equal(_column(near, place), _column(person, place))
