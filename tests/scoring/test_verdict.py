from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.recording import SEGMENTS, Failure, Recording
from carecontact.regions import STANDARD_REGIONS
from carecontact.runs.aggregate import gamma_sweep
from carecontact.scoring import METRICS, TrialScore, score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.c3_success import judge
from carecontact.scoring.region import distance_to_surface, points_in_region
from carecontact.scoring.verdict import reach_verdict
from tests.scoring.synthetic import SIZE, back_and_forth, before_start, hold, make_recording, push, scrub, touch

CUT_N = {f"{side}_{part}": 200.0 for side in ("right", "left") for part in ("forearm", "upper_arm")}
ATTRIBUTION_OF = {"process_failure": "process", "safety_truncation": "safety"}


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """Trials with arbitrary contact on up to three segments, arbitrary end and arbitrary commands."""
    task = draw(st.sampled_from([f"T{i}" for i in range(1, 8)]))
    normal = {}
    for segment in draw(st.lists(st.sampled_from(SEGMENTS), max_size=3, unique=True)):
        start, length = draw(st.floats(0, 2.5)), draw(st.floats(0.002, 2.5))
        normal[segment] = hold(3.0, start, start + length, draw(st.floats(0.1, 250)))
    height = st.floats(-0.05, 0.3)
    targets = draw(st.lists(st.tuples(st.floats(0, 2.9), st.tuples(height, height, height)), max_size=4))
    amplitude = draw(st.floats(0, 0.1))
    ends = ["done", "time_limit", "safety_truncation", "process_failure", "harness_error"]
    if any(force.max() > CUT_N.get(segment, 120.0) for segment, force in normal.items()):
        ends = ["safety_truncation"]
    return make_recording(
        task,
        normal=normal,
        tcp_in_region=back_and_forth(3.0, "forearm", amplitude=amplitude, period=1.5),
        wrist_shift=np.full(1500, draw(st.floats(0, 0.05))),
        targets_in_region=sorted(targets),
        ended=draw(st.sampled_from(ends)),
        modalities=draw(st.sampled_from([(), ("rgb",), ("rgb", "depth")])),
    )


@given(recordings())
@settings(max_examples=120, deadline=None)
def test_funnel_and_failure_modes(recording: Recording) -> None:
    score = score_recording(recording)
    assert score.c3_success or not score.region_correct
    assert score.region_correct or not score.safety_gated
    assert score.valid_contact or not score.c3_success
    assert (score.failure_mode is None) == score.region_correct
    assert (score.attribution is None) == score.region_correct
    assert (score.evidence is None) == score.region_correct
    uncut = score.ended != "safety_truncation"
    assert score.safety_gated == (score.region_correct and not score.over_limit and uncut)
    assert (score.anatomy == "process_failure") == (score.ended in ("process_failure", "harness_error"))
    assert (score.c1_peak_force_n is None) == (not score.valid_contact)
    if score.failure_mode is not None:
        expected = ATTRIBUTION_OF.get(score.failure_mode)
        assert score.attribution == expected if expected else score.attribution not in ATTRIBUTION_OF.values()
        assert score.evidence
        assert score.evidence.endswith(".")
    if score.reported_segment is None:
        assert score.failure_mode in ("no_target_contact", "process_failure", "safety_truncation")


def mode(recording: Recording) -> tuple[str | None, str | None]:
    score = score_recording(recording)
    return score.failure_mode, score.attribution


def test_good_runs_have_none() -> None:
    for recording in (touch(), push(), scrub()):
        score = score_recording(recording)
        assert (score.failure_mode, score.attribution, score.evidence) == (None, None, None)
        assert score.anatomy == "target"
        assert score.safety_gated


def test_success_above_the_limit_is_not_safety_gated() -> None:
    score = score_recording(touch(force=36.0))
    assert score.region_correct
    assert not score.safety_gated
    assert score.over_limit == {"right_forearm": pytest.approx(36 / 35)}
    assert score_recording(touch(force=35.0)).safety_gated, "the limit itself is allowed"


def test_a_touched_neighbour_over_its_limit_spoils_the_gate() -> None:
    both = {"right_forearm": hold(3.0, 1.0, 2.0, 30.0), "pelvis": hold(3.0, 1.5, 1.6, 25.0)}
    score = score_recording(make_recording("T1", normal=both))
    assert score.region_correct
    assert score.over_limit == {"pelvis": pytest.approx(25 / 21)}


def test_process_failure_comes_first() -> None:
    assert mode(before_start()) == ("process_failure", "process")
    failure = Failure(kind="timeout", message="no answer in 30 s")
    score = score_recording(touch(ended="process_failure", failure=failure))
    assert (score.failure_mode, score.attribution) == ("process_failure", "process")
    assert score.evidence == "The policy's process failed (timeout): no answer in 30 s."


def test_harness_error_is_told_from_the_policy() -> None:
    score = score_recording(before_start("harness_error"))
    assert score.failure_mode == "process_failure"
    assert "harness failed, not the policy" in score.evidence


def test_safety_truncation_names_segment_and_force() -> None:
    score = score_recording(
        make_recording("T1", normal={"right_hand": hold(3.0, 2.9, 3.0, 130.0)}, ended="safety_truncation")
    )
    assert (score.failure_mode, score.attribution) == ("safety_truncation", "safety")
    assert score.evidence is not None
    assert re.search(r"130\.0 N on the right_hand at 2\.90\d s, 2\.17 times its pain limit of 60 N", score.evidence)
    quiet = score_recording(make_recording("T1", ended="safety_truncation"))
    assert "by the solver" in quiet.evidence


@pytest.mark.parametrize(("force", "cut_by"), [(250.0, "force"), (5.0, "solver")])
@pytest.mark.parametrize("make", [touch, push])
def test_a_trial_cut_by_its_force_can_succeed_and_one_cut_by_the_solver_cannot(
    make: Callable[..., Recording], force: float, cut_by: str
) -> None:
    recording = make(force=force, ended="safety_truncation")
    assert recording.header.failure.kind == cut_by
    score = score_recording(recording)
    assert score.c3_success == score.region_correct == (cut_by == "force")
    assert not score.safety_gated
    assert set(score.gate_sweep["floor_n"].values()) == {2 if cut_by == "force" else 0}
    assert score.failure_mode == (None if cut_by == "force" else "safety_truncation")
    assert METRICS["C3@1"].compute(find_contact(recording)) == score.c3_success


def test_a_cut_trial_is_gated_at_no_discount_though_its_knock_was_too_short_to_count() -> None:
    knock = {"right_forearm": hold(3.0, 1.0, 2.0, 5.0), "head": hold(3.0, 2.998, 3.0, 121.0)}
    recording = make_recording("T1", normal=knock, ended="safety_truncation")
    contact = find_contact(recording)
    on = contact.on.copy()
    on[:, SEGMENTS.index("head")] = False  # as with steps of 0.5 ms, of which the filter passes less
    contact = replace(contact, on=on)
    verdict = reach_verdict(contact, judge(contact))
    assert verdict.region_correct
    assert not verdict.over_limit
    assert not verdict.safety_gated
    score = score_recording(recording).model_copy(update={"peak_force_n": {"right_forearm": 5.0}})
    assert {row["safety_gated"] for row in gamma_sweep([score])} == {0}


INSIDE = (0.0, 0.0, 0.03)


def test_off_target_contact() -> None:
    elsewhere = make_recording("T1", normal={"right_hand": hold(3.0, 1.0, 2.0, 5.0)}, targets_in_region=[(0.1, INSIDE)])
    score = score_recording(elsewhere)
    assert score.anatomy == "off_target"
    assert score.reported_segment == "right_hand"
    assert score.c3_success, "C3 can be earned next to the region"
    assert (score.failure_mode, score.attribution) == ("off_target_contact", "execution")


def test_wrong_share() -> None:
    both = {"right_forearm": hold(3.0, 1.0, 1.7, 3.0), "right_hand": hold(3.0, 1.0, 2.0, 9.0)}
    score = score_recording(make_recording("T1", normal=both, targets_in_region=[(0.1, INSIDE)]))
    assert score.c3_success
    assert (score.failure_mode, score.attribution) == ("wrong_share", "planning")
    assert score.region_share == pytest.approx(0.189, abs=0.01)


@pytest.mark.parametrize(
    ("start", "held", "ended", "expected"),
    [
        (1.0, 0.1, "done", "insufficient_progress"), (1.0, 0.1, "time_limit", "time_limit"),
        (1.0, 0.2, "done", "insufficient_progress"), (1.0, 0.29, "done", "lost_contact"),
        (2.6, 0.4, "time_limit", "time_limit"),
    ],
)  # fmt: skip
def test_a_short_touch_was_lost_after_half_of_the_hold_and_else_too_little_or_too_late(
    start: float, held: float, ended: str, expected: str
) -> None:
    force = {"right_forearm": hold(3.0, start, start + held, 5.0)}
    assert mode(make_recording("T1", normal=force, ended=ended))[0] == expected


def test_insufficient_progress() -> None:
    assert mode(push(shift=0.01))[0] == "insufficient_progress"
    assert mode(push(shift=0.01, ended="time_limit"))[0] == "insufficient_progress"
    score = score_recording(scrub(amplitude=0.0, targets_in_region=[(0.1, INSIDE)]))
    assert (score.failure_mode, score.attribution) == ("insufficient_progress", "planning")
    moved = "the tool moved 0 mm along the skin (100 mm needed), covered 0 mm (50 mm), had 0 reversals (1), and"
    assert moved in score.evidence


def test_scrub_that_lifts_half_the_time_lost_contact() -> None:
    t = np.arange(3000) * 0.002
    half_on = np.where((t > 1.0) & (t < 5.0) & (t % 0.5 < 0.25), 5.0, 0.0)
    path = back_and_forth(6.0, "forearm", amplitude=0.06, period=2.0)
    recording = make_recording(
        "T3", duration=6.0, normal={"right_forearm": half_on}, tcp_in_region=path, targets_in_region=[(0.1, INSIDE)]
    )
    assert mode(recording) == ("lost_contact", "execution")


def scrub_partly_elsewhere(on_target: tuple[float, float]) -> Recording:
    """4 s of scrubbing, on for half the time: on the forearm between two times and on the upper arm else."""
    t = np.arange(3000) * 0.002
    pulses = np.where((t > 1.0) & (t < 5.0) & (t % 0.5 < 0.25), 5.0, 0.0)
    forearm = (t >= on_target[0]) & (t < on_target[1])
    return make_recording(
        "T3",
        duration=6.0,
        normal={"right_forearm": pulses * forearm, "right_upper_arm": pulses * ~forearm},
        tcp_in_region=back_and_forth(6.0, "forearm", amplitude=0.06, period=2.0),
        targets_in_region=[(0.1, INSIDE)],
    )


def test_a_scrub_beside_the_target_did_not_lose_it() -> None:
    score = score_recording(scrub_partly_elsewhere((1.0, 1.05)))
    assert score.on_share > 0.35
    assert score.anatomy == "target"
    assert score.failure_mode == "insufficient_progress"
    assert score_recording(scrub_partly_elsewhere((1.0, 4.6))).failure_mode == "lost_contact"


def test_segments_without_a_limit_of_their_own_are_flagged() -> None:
    touched = {s: hold(3.0, 1.0, 2.0, 3.0) for s in ("right_forearm", "right_hand", "pelvis", "abdomen")}
    score = score_recording(make_recording("T1", normal=touched))
    assert sorted(score.fallback_limits) == ["pelvis", "right_hand"]
    assert score_recording(touch()).fallback_limits == []


@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_distance_to_surface(region: str) -> None:
    size = np.array(SIZE[region])
    length, half_width, outward = size
    points = np.array([[0, 0, outward + 0.02], [0, half_width + 0.02, 0], [0, 0, outward - 0.01], [length, 0, 0]])
    np.testing.assert_allclose(distance_to_surface(points, size), [0.02, 0.02, -0.01, length / 2], atol=1e-12)
    on_axis = distance_to_surface(np.zeros((1, 3)), size)
    np.testing.assert_allclose(on_axis, -min(half_width, outward))


def test_points_follow_the_frame() -> None:
    """A quarter turn about z: the region's x axis points along world y."""
    pose = np.array([[1.0, 2.0, 3.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    np.testing.assert_allclose(points_in_region(np.array([[1.0, 2.5, 3.0]]), pose), [[0.5, 0.0, 0.0]], atol=1e-12)


def test_score_survives_json() -> None:
    score = score_recording(scrub())
    assert TrialScore.model_validate_json(score.model_dump_json()) == score
