from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from carecontact.interface.policy import CAMERAS
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.recording.notes import JOINTS
from carecontact.scoring import TrialScore, score_recording
from carecontact.scoring.progress import distance_to_shadow
from tests.scoring.synthetic import BASE, REGION_AT, back_and_forth, hold, make_recording

HIGH = np.tile([0.0, 0.0, 0.4], (1500, 1))
BESIDE, ABOVE, NEAR, INSIDE = (0.0, 0.4, 0.1), (0.0, 0.0, 0.3), (0.0, 0.0, 0.055), (0.0, 0.0, 0.03)
ALL = ("rgb", "depth", "points", "masks", "landmarks")


def views(*, visible: bool = True, error_m: float = 0.01, count: int = 2) -> dict[str, Any]:
    """Recorded views in which every joint is or is not to be seen, and in which regions are found ``error_m`` off."""
    joints = np.full((count, len(JOINTS)), visible)
    target = np.zeros((count, len(STANDARD_REGIONS), 3), np.float32)
    target[..., 0] = error_m
    return {
        "perception/observation_index": np.arange(count, dtype=np.int32),
        "perception/camera_index": np.full(count, CAMERAS.index("overhead"), np.int32),
        "perception/joint_visible": joints,
        "perception/landmark_error_px": np.where(joints, 3.0, np.nan).astype(np.float32),
        "perception/human_iou": np.full(count, 0.99, np.float32),
        "perception/target_error_m": target,
    }


def note(place: tuple[float, float, float] | None = None, **content: Any) -> dict[str, Any]:
    """A note of the first observation; ``place``: in the world, written as the policy's target in its base."""
    if place is not None:
        content["target_m"] = (np.array(place) - BASE[:3]).tolist()
    text = np.frombuffer(json.dumps(content).encode(), np.uint8)
    return {
        "policy/observation_time_s": np.array([0.0]),
        "policy/observation_sha256": np.zeros((1, 32), np.uint8),
        "policy/notes/000000/json": text,
    }


def scored(*targets: tuple[float, float, float], modalities: tuple[str, ...] = ALL, **extra: Any) -> TrialScore:
    """No contact; targets in the forearm's frame, half a second apart."""
    timed = [(0.5 * (k + 1), target) for k, target in enumerate(targets)]
    return score_recording(
        make_recording("T1", targets_in_region=timed, tcp_in_region=HIGH, modalities=modalities, extra=extra)
    )


@pytest.mark.parametrize(
    ("targets", "extra", "expected"),
    [
        ([BESIDE], views(), "perception"),
        ([BESIDE], views(error_m=0.2), "perception"),
        ([BESIDE], views(visible=False), "planning"),
        ([BESIDE], {}, "planning"),
        ([ABOVE], views(), "planning"),
        ([ABOVE, BESIDE], views(), "perception"),
        ([NEAR], views(), "planning"),
        ([INSIDE], views(), "execution"),
        ([(0.0, 0.2, 0.0), (0.0, -0.2, 0.0)], views(), "execution"),
        ([], views(), "planning"),
        ([], views(error_m=float("nan")), "perception"),
        ([], views(visible=False, error_m=float("nan")), "planning"),
        ([], {}, "planning"),
    ],
    ids=[
        "elsewhere", "elsewhere, found wrong", "elsewhere, hidden", "elsewhere, nothing recorded", "hovers",
        "over it on the way elsewhere", "stops above", "reaches", "passes through between targets", "gives up",
        "does not find it", "hidden from it", "still, nothing recorded",
    ],
)  # fmt: skip
def test_nothing_touched(targets: list, extra: dict[str, Any], expected: str) -> None:
    score = scored(*targets, **extra)
    assert (score.failure_mode, score.attribution) == ("no_target_contact", expected)


@pytest.mark.parametrize("targets", [[], [BESIDE]], ids=["still", "elsewhere"])
def test_without_images_it_is_never_perception(targets: list) -> None:
    score = scored(*targets, modalities=())
    assert score.attribution == "planning"
    assert score.evidence.endswith("the policy asked for no images.")


def test_evidence_names_the_miss_and_what_was_in_view() -> None:
    assert scored(BESIDE, **views(count=3)).evidence == (
        "The commanded path was aimed 355 mm beside the forearm; the forearm was in view in 3 of 3 and could be found "
        "in 3 (middle error 10 mm)."
    )
    assert scored(ABOVE, **views()).evidence == (
        "The commanded path was aimed at the forearm and stayed 255 mm off its surface; the robot touched nothing."
    )
    near = scored(NEAR, **views()).evidence or ""
    assert near.endswith("above the surface of the forearm; the robot touched nothing.")
    inside = scored(INSIDE, **views()).evidence or ""
    assert inside.endswith("below the surface of the forearm, yet the robot touched nothing.")
    assert scored(**views()).evidence == (
        "No motion was commanded; the forearm was in view in 2 of 2 and could be found in 2 (middle error 10 mm)."
    )
    assert scored(BESIDE, modalities=("rgb",)).evidence == (
        "The commanded path was aimed 355 mm beside the forearm; the policy saw rgb, and whether the forearm was in "
        "view is not recorded."
    )


def test_a_policy_that_finds_the_person_in_part_of_its_views() -> None:
    mixed = views(count=4)
    mixed["perception/joint_visible"][1:] = False
    mixed["perception/landmark_error_px"][1:] = np.nan
    score = scored(BESIDE, **mixed)
    assert score.attribution == "perception"
    assert "in view in 1 of 4 and could be found in 1" in (score.evidence or "")


def test_key_points_alone_tell_whether_the_region_could_be_found() -> None:
    blind = views(error_m=float("nan"))
    assert scored(modalities=("rgb", "landmarks"), **blind).attribution == "planning"
    blind["perception/landmark_error_px"][:] = np.nan
    blind["perception/human_iou"][:] = np.nan
    assert scored(modalities=("rgb", "landmarks"), **blind).attribution == "perception"


def test_a_program_that_chose_another_part_is_planning() -> None:
    """The recording holds the target that the program asked for."""
    extra = views() | note(REGION_AT["upper_arm"], subtask="touch the right upper arm")
    score = scored(BESIDE, **extra)
    assert score.attribution == "planning"
    assert '("touch the right upper arm") lay 202 mm beside it, over the upper arm' in (score.evidence or "")


def test_a_program_that_goes_nowhere_is_planning() -> None:
    """What a soft refusal of a language model looks like: it goes home, and notes what it set out to do."""
    extra = views() | note(subtasks=["back to default pose", 7, ""])
    score = scored(BESIDE, **extra)
    assert score.attribution == "planning"
    assert 'beside the forearm: the policy noted "back to default pose" and no target; the' in (score.evidence or "")
    assert scored(BESIDE, **views(error_m=0.3), **note(subtasks=["touch"])).attribution == "perception"
    assert scored(BESIDE, **views(), **note(subtasks=[])).attribution == "perception"


def test_a_program_misled_by_what_it_was_given_is_perception() -> None:
    extra = views(error_m=0.3) | note(REGION_AT["upper_arm"], subtask="touch the right forearm")
    assert scored(BESIDE, **extra).attribution == "perception"


def test_the_state_machines_choice_is_a_noted_target_too() -> None:
    corner = (np.array(REGION_AT["abdomen"]) - BASE[:3]).tolist()
    extra = note(intent={"region": "abdomen"}, options=[{"corners_m": [[0, 0, 0]]}, {"corners_m": [corner]}], chosen=1)
    score = scored(BESIDE, **views(), **extra)
    assert score.attribution == "planning"
    assert '("abdomen") lay' in (score.evidence or "")
    assert "over the abdomen" in (score.evidence or "")


@pytest.mark.parametrize(
    "content",
    [
        {"target_m": "left"},
        {"target_m": [1, 2]},
        {"target_m": [1e9, 0, 0]},
        {"options": [1], "chosen": 0},
        {"options": [], "chosen": 3},
        {"intent": 7, "subtask": ["x"]},
    ],
)
def test_notes_of_another_form_are_passed_over(content: dict[str, Any]) -> None:
    assert scored(BESIDE, **views(), **note(**content)).attribution == "perception"


def test_what_a_still_policy_noted_is_evidence() -> None:
    extra = views(error_m=float("nan")) | note(ended_because="right elbow\nnot found " + "x" * 200)
    evidence = scored(**extra).evidence or ""
    assert 'The policy noted: "right elbow not found xxx' in evidence
    assert len(evidence) < 300


@pytest.mark.parametrize(("until", "expected"), [(2.0, "execution"), (1.2, "planning")])
def test_a_hold_that_was_asked_for_and_not_given_is_execution(until: float, expected: str) -> None:
    tap = {"right_forearm": hold(3.0, 1.0, 1.1, 5.0)}
    targets = [(0.9, INSIDE), (until, ABOVE)]
    score = score_recording(make_recording("T1", normal=tap, targets_in_region=targets, extra=views()))
    assert (score.failure_mode, score.attribution) == ("insufficient_progress", expected)
    assert ("asked for 1.10 s there" in (score.evidence or "")) == (expected == "execution")


@pytest.mark.parametrize(
    ("taps", "up_s", "message", "expected"),
    [
        (1, 0.6, "lost once, while the commanded target lay above", "planning"),
        (1, 1.6, "lost once, while the commanded target lay on or under", "execution"),
        (2, 0.6, "lost 2 times; in 0 of them", "planning"),
        (2, 1.6, "lost 2 times; in 1 of them", "planning"),
        (2, 2.8, "lost 2 times; in 2 of them", "execution"),
    ],
)
def test_contact_is_lost_by_execution_where_most_losses_were_not_commanded(
    taps: int, up_s: float, message: str, expected: str
) -> None:
    force = np.sum([hold(3.0, 1.0 + tap, 1.4 + tap, 5.0) for tap in range(taps)], axis=0)
    targets = [(0.5, INSIDE), (up_s, ABOVE)]
    score = score_recording(make_recording("T1", normal={"right_forearm": force}, targets_in_region=targets))
    assert (score.failure_mode, score.attribution) == ("lost_contact", expected)
    assert message in (score.evidence or "")


@pytest.mark.parametrize(
    ("ends", "expected"), [((-0.06, 0.06, -0.06), "execution"), ((-0.06, 0.06), "planning"), ((0.0,), "planning")]
)
def test_a_scrub_that_was_asked_for_and_not_given_is_execution(ends: tuple, expected: str) -> None:
    recording = make_recording(
        "T3",
        duration=6.0,
        normal={"right_forearm": hold(6.0, 1.0, 5.0, 5.0)},
        tcp_in_region=back_and_forth(6.0, "forearm", amplitude=0.01, period=2.0),
        targets_in_region=[(0.5 + k, (x, 0.0, 0.03)) for k, x in enumerate(ends)],
    )
    score = score_recording(recording)
    assert (score.failure_mode, score.attribution) == ("insufficient_progress", expected)


def test_distance_to_shadow() -> None:
    """A quarter turn about z, then an upright axis: height never counts."""
    size = np.array([0.2, 0.05, 0.04])
    half = np.sqrt(0.5)
    lying, upright = [1.0, 2.0, 3.0, half, 0.0, 0.0, half], [0.0, 0.0, 0.0, half, 0.0, -half, 0.0]
    points = np.array([[1.0, 2.09, 9.0], [1.0, 2.15, 3.0], [1.08, 2.0, -4.0], [1.09, 2.13, 0.0]])
    found = distance_to_shadow(points, np.tile(lying, (4, 1)), size)
    np.testing.assert_allclose(found, [0.0, 0.05, 0.03, 0.05], atol=1e-12)
    assert distance_to_shadow(np.array([[0.3, 0.0, 0.0]]), np.array([upright]), size)[0] == pytest.approx(0.3)
