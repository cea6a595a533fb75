from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.protocol.gates import Gates
from carecontact.protocol.load import load_protocol
from carecontact.recording import SEGMENTS, Failure, Recording
from carecontact.runs.results_file import contradiction, gamma_sweep, quadrants
from carecontact.scoring import METRICS, TrialScore, score_recording, verdict
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.success import judge
from carecontact.scoring.progress import (
    count_reversals,
    distance_to_surface,
    measure_episodes,
    points_in_region,
    surface_track,
)
from carecontact.scoring.verdict import reach_verdict
from tests.scoring.synthetic import (
    GATES,
    GENTLE,
    JOINT_RANGE,
    SIZE,
    TABLE,
    back_and_forth,
    before_start,
    hold,
    make_recording,
    push,
    scrub,
    seconds,
    target_segment,
    touch,
)

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
@settings(max_examples=60, deadline=None)
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


def test_harness_error_is_not_the_policys() -> None:
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
        (1.0, 0.1, "done", "insufficient_progress"),
        (1.0, 0.1, "time_limit", "time_limit"),
        (1.0, 0.2, "done", "insufficient_progress"),
        (1.0, 0.29, "done", "lost_contact"),
        (2.6, 0.4, "time_limit", "time_limit"),
    ],
)
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


@pytest.mark.parametrize(("duration", "passes"), [(0.55, True), (0.3, False)])
def test_touch_needs_half_a_second(duration: float, passes: bool) -> None:
    recording = make_recording("T1", normal={"right_forearm": hold(3.0, 1.0, 1.0 + duration, 5.0)})
    assert score_recording(recording).c3_success is passes


def test_touch_must_be_continuous() -> None:
    taps = sum(hold(3.0, start, start + 0.3, 5.0) for start in (0.5, 1.0, 1.5, 2.0))
    score = score_recording(make_recording("T1", normal={"right_forearm": np.asarray(taps)}))
    assert score.contact_s > 1.2
    assert not score.c3_success


@pytest.mark.parametrize(
    ("force", "shift", "passes"), [(8.0, 0.03, True), (8.0, 0.019, False), (2.9, 0.03, False), (3.1, 0.021, True)]
)
def test_push_needs_force_and_displacement(force: float, shift: float, passes: bool) -> None:
    score = score_recording(push(force=force, shift=shift))
    assert score.c3_success is passes
    assert score.wrist_displacement_m == pytest.approx(shift, abs=1e-6)


def test_push_is_by_the_summed_force_and_not_by_the_sum_of_norms() -> None:
    """Two segments pressed against each other add up to nothing that pushes the arm."""
    both = {"right_forearm": hold(3.0, 1.0, 2.5, 8.0), "right_hand": hold(3.0, 1.0, 2.5, 8.0)}
    squeezed = make_recording("T2", normal=both, wrist_shift=np.full(1500, 0.03))
    assert score_recording(squeezed).c3_success
    squeezed["scorer/force_human_from_robot_in_world"][:, SEGMENTS.index("right_hand"), 2] *= -1
    assert find_contact(squeezed).neighbourhood_force.max() == 0.0
    assert not score_recording(squeezed).c3_success


def test_the_required_share_itself_is_region_correct() -> None:
    contact = find_contact(touch())
    for on_target, correct in ((8.0, True), (np.nextafter(8.0, 0.0), False)):
        impulse = np.zeros(len(SEGMENTS))
        impulse[contact.target], impulse[SEGMENTS.index("head")] = on_target, 2.0
        shared = replace(contact, impulse_ns=impulse)
        assert (shared.region_share == 0.8) is correct
        assert reach_verdict(shared, judge(shared)).region_correct is correct


def test_push_counts_only_displacement_under_contact() -> None:
    """The arm swings back after the robot has let go: not pushed there."""
    later = np.where(seconds(3.0) > 2.7, 0.05, 0.0)
    recording = make_recording("T2", normal={"right_forearm": hold(3.0, 1.0, 2.5, 8.0)}, wrist_shift=later)
    score = score_recording(recording)
    assert not score.c3_success
    assert score.wrist_displacement_m < 1e-6
    assert score.wrist_displacement_any_m == pytest.approx(0.05, abs=1e-6)


def test_pressing_down_is_no_push() -> None:
    recording = make_recording("T2", normal={"right_forearm": hold(3.0, 0.5, 3.0, 60.0)})
    recording.arrays["scorer/wrist_in_world"][:, 2] -= 0.05
    assert not score_recording(recording).c3_success


def test_push_hold_must_be_one_second() -> None:
    dips = hold(3.0, 0.5, 2.9, 8.0) - sum(hold(3.0, t, t + 0.01, 6.0) for t in (1.0, 1.6, 2.2))
    recording = make_recording("T2", normal={"right_forearm": dips}, wrist_shift=np.full(1500, 0.03))
    assert score_recording(recording).longest_on_s < 0.8
    assert not score_recording(recording).c3_success


def test_scrub_measures_a_known_swing() -> None:
    """4 s of a 60 mm swing with a 2 s period: path 4 A per period, two turns per period, P95 - P5 of a sine."""
    score = score_recording(scrub(amplitude=0.06))
    assert score.c3_success
    assert score.stroke_m == pytest.approx(4 * 0.06 * 2, rel=0.03)
    assert score.extent_m == pytest.approx(2 * 0.06 * np.sin(np.pi / 2 * 0.9), rel=0.02)
    assert score.reversals == 4
    assert score.on_share == 1.0


def test_scrub_needs_extent() -> None:
    score = score_recording(scrub(amplitude=0.02))
    assert score.stroke_m > 0.1
    assert score.extent_m < 0.05
    assert not score.c3_success


def wipes(*, lifted: bool) -> Recording:
    """Three wipes in the same direction; between them the tool returns, in the air or not."""
    t = seconds(6.0)
    phase = (t - 0.5) % 1.5
    x = np.where(phase < 1.0, -0.06 + 0.12 * phase, 0.06 - 0.24 * (phase - 1.0))
    touching = np.where((t > 0.5) & (t < 5.0) & ((phase < 0.9) | (not lifted)), 5.0, 0.0)
    path = np.stack([x, np.zeros_like(x), np.full_like(x, 0.045)], axis=1)
    return make_recording("T3", duration=6.0, normal={"right_forearm": touching}, tcp_in_region=path)


def test_one_way_wiping_with_lifts_is_no_scrub() -> None:
    lifted, rubbed = score_recording(wipes(lifted=True)), score_recording(wipes(lifted=False))
    assert lifted.stroke_m > 0.2
    assert lifted.reversals == 0
    assert not lifted.c3_success
    assert rubbed.c3_success


def test_stroke_moves_with_the_bone() -> None:
    """The arm swings under a tool that moves along with it: no stroke. A still tool on a swinging arm: stroke."""
    carried, still = scrub(amplitude=0.0), scrub(amplitude=0.0)
    swing = back_and_forth(6.0, "forearm", amplitude=0.06, period=2.0)[:, 0].astype(np.float32)
    for recording in (carried, still):
        recording.arrays["scorer/region_pose_in_world"][:, 0, 0] += swing
    carried.arrays["scorer/pose_tcp_in_world"][:, 0] += swing
    assert score_recording(carried).stroke_m < 1e-4
    assert score_recording(still).stroke_m == pytest.approx(0.48, rel=0.03)


def test_circumference_counts_as_stroke_and_not_as_extent() -> None:
    t = seconds(6.0)
    angle = 0.5 * np.sin(np.pi * t)
    path = np.stack([np.zeros_like(t), 0.045 * np.sin(angle), 0.045 * np.cos(angle)], axis=1)
    recording = make_recording(
        "T3", duration=6.0, normal={"right_forearm": hold(6.0, 1.0, 5.0, 5.0)}, tcp_in_region=path
    )
    score = score_recording(recording)
    assert score.stroke_m == pytest.approx(8 * 0.5 * 0.045, rel=0.03)
    assert score.extent_m == pytest.approx(0.0, abs=1e-6)


def test_a_good_scrub_and_a_stray_touch_is_a_good_scrub() -> None:
    normal = hold(9.0, 1.0, 5.0, 5.0) + hold(9.0, 7.0, 7.2, 5.0)
    path = back_and_forth(9.0, "forearm", amplitude=0.06, period=2.0)
    contact = find_contact(make_recording("T3", duration=9.0, normal={"right_forearm": normal}, tcp_in_region=path))
    assert len(measure_episodes(contact)) == 2
    assert score_recording(contact.recording).c3_success


def test_samples_are_joined_where_every_step_between_them_is_on() -> None:
    on = np.random.default_rng(1).random(1500) < 0.9
    track = surface_track(replace(find_contact(make_recording("T3")), neighbourhood_on=on))
    assert track.joined.any()
    assert track.joined.tolist() == [on[a : b + 1].all() for a, b in pairwise(track.step)]


def test_scrub_needs_its_share_of_contact() -> None:
    t = seconds(6.0)
    half_on = np.where((t > 1.0) & (t < 5.0) & (t % 0.5 < 0.25), 5.0, 0.0)
    path = back_and_forth(6.0, "forearm", amplitude=0.06, period=2.0)
    score = score_recording(make_recording("T3", duration=6.0, normal={"right_forearm": half_on}, tcp_in_region=path))
    assert 0.4 < score.on_share < 0.7
    assert not score.c3_success


@given(st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=12))
def test_reversals_of_a_zigzag(corners: list[float]) -> None:
    """Interpolated corners: as many reversals as the corners alone, and none below the threshold."""
    line = np.interp(np.linspace(0, len(corners) - 1, 40 * len(corners)), np.arange(len(corners)), corners)
    with_corners = np.sort(np.concatenate([np.arange(len(corners)), np.linspace(0, len(corners) - 1, 40)]))
    dense = np.interp(with_corners, np.arange(len(corners)), corners)
    assert count_reversals(dense, 0.01) == count_reversals(np.array(corners), 0.01)
    assert count_reversals(line, 1.0) == 0
    assert count_reversals(np.sort(line), 0.01) == 0


def test_reversals_by_hand() -> None:
    assert count_reversals(np.array([0.0, 0.05, 0.0, 0.05]), 0.01) == 2
    assert count_reversals(np.array([0.0, 0.05, 0.041, 0.06]), 0.01) == 0
    assert count_reversals(np.array([0.0, -0.03, -0.019]), 0.01) == 1
    assert count_reversals(np.array([]), 0.01) == 0


def test_success_needs_contact_and_a_living_policy() -> None:
    for task in ("T1", "T2", "T3"):
        assert not score_recording(make_recording(task)).c3_success
    assert score_recording(touch()).c3_success
    assert not score_recording(touch(ended="process_failure")).c3_success
    assert not score_recording(touch(ended="harness_error")).c3_success


# The gate for joints: beyond its limit a trial is not safety-gated, and a flag fails nothing.

PROTOCOL = load_protocol("bathing-v3")
LIMIT = float(np.radians(5.0))
GATED = GENTLE.model_copy(update={"gates": GATES.model_copy(update={"joint_beyond_rad": LIMIT})})


def score(protocol, *, past_rad: float):
    """A push that passes its gates, while a joint goes this far past its upper end."""
    joints = np.ones((1000, 2))
    joints[500, 0] = JOINT_RANGE[0][1] + past_rad
    recording = make_recording(
        "T1", duration=2.0, normal={target_segment("T1"): hold(2.0, 0.2, 1.9, 5.0)}, joints=joints, protocol=protocol
    )
    return score_recording(recording)


def test_a_joint_beyond_the_limit_is_not_safety_gated() -> None:
    inside, beyond = score(GATED, past_rad=LIMIT - 0.01), score(GATED, past_rad=LIMIT + 0.01)
    assert inside.safety_gated
    assert inside.joints_beyond == {}
    assert beyond.region_correct
    assert not beyond.safety_gated
    assert beyond.joints_beyond == {"right_shoulder_abduction": pytest.approx(LIMIT + 0.01, abs=1e-6)}


def test_a_sweep_of_the_gates_does_not_measure_the_joints_again(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[float] = []
    monkeypatch.setattr(verdict, "_joints_above", lambda recording, values, limit: measured.append(limit) or {})
    assert sum(map(len, score(GATED, past_rad=0.0).gate_sweep.values())) > 2
    assert measured == [LIMIT, GATED.gates.joint_consumed] * 2, "for the verdict, and for the metric of the harder band"


def test_a_joint_beyond_the_limit_is_reported_and_counted_as_unsafe_everywhere() -> None:
    inside, beyond = score(GATED, past_rad=LIMIT - 0.01), score(GATED, past_rad=LIMIT + 0.01)
    assert inside.failure_mode is None
    assert (beyond.failure_mode, beyond.attribution) == ("joint_beyond_range", "safety")
    assert beyond.evidence == (
        f"The right shoulder abduction was {LIMIT + 0.01:.3f} rad beyond its range at 1.002 s; "
        f"the protocol allows {LIMIT:.3f} rad."
    )
    assert contradiction(beyond) is None
    assert quadrants([inside, beyond]) == {
        "safe_success": 1,
        "safe_failure": 0,
        "unsafe_success": 1,
        "unsafe_failure": 0,
        "crashed": 0,
    }
    assert {row["safety_gated"] for row in gamma_sweep([inside, beyond], [GATED.limits.gamma, 1.0])} == {1}


def test_a_stored_score_cannot_be_safety_gated_with_a_joint_too_far() -> None:
    claimed = score(GATED, past_rad=LIMIT + 0.01).model_copy(update={"safety_gated": True})
    assert "right_shoulder_abduction beyond its range" in str(contradiction(claimed))


def test_a_joint_that_used_up_most_of_its_margin_is_flagged_and_fails_nothing() -> None:
    """Settled 1.5 rad from its upper end."""
    used, spared = score(GATED, past_rad=-0.2), score(GATED, past_rad=-0.4)
    assert used.joints_consumed == {"right_shoulder_abduction": pytest.approx(1 - 0.2 / 1.5, abs=1e-6)}
    assert used.safety_gated
    assert spared.joints_consumed == {}


def test_the_papers_gates_do_not_judge_joints() -> None:
    beyond = score(PROTOCOL, past_rad=LIMIT + 0.01)
    assert beyond.safety_gated
    assert beyond.joints_beyond is None


@pytest.mark.parametrize("change", [{"set": "exam"}, {"joint_beyond_rad": 0.1}])
def test_the_joints_gate_goes_with_the_exam(change: dict[str, object]) -> None:
    tables = {name: value for name, value in TABLE.items() if not name.startswith("joint")}
    if "set" not in change:
        tables = PROTOCOL.gates.model_dump()
    with pytest.raises(ValidationError, match="exam's gates, which need both"):
        Gates.model_validate(tables | change)
