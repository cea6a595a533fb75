from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.recording import SEGMENTS, Recording
from carecontact.scoring import score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.c3_success import judge
from carecontact.scoring.progress import count_reversals, measure_episodes, surface_track
from carecontact.scoring.verdict import reach_verdict
from tests.scoring.synthetic import back_and_forth, hold, make_recording, push, scrub, seconds, touch


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
