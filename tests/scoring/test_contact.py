from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal

from carecontact.protocol.protocol import Protocol
from carecontact.recording import Recording
from carecontact.scoring import score_recording
from carecontact.scoring.contact import (
    episodes,
    faint_press,
    find_contact,
    hysteresis,
    longest_run,
    low_pass,
    runs,
    steps,
)
from tests.scoring.synthetic import DT, PROTOCOL, SIZE, hold, make_recording, seconds, touch


@given(arrays(np.float64, st.tuples(st.integers(0, 60), st.integers(1, 3)), elements=st.floats(0, 1)))
def test_hysteresis_equals_the_loop(signal: np.ndarray) -> None:
    expected = np.zeros(signal.shape, bool)
    for column in range(signal.shape[1]):
        state = False
        for row, value in enumerate(signal[:, column].tolist()):
            state = value >= 0.5 or (state and value >= 0.25)
            expected[row, column] = state
    np.testing.assert_array_equal(hysteresis(signal, on=0.5, off=0.25), expected)


@given(arrays(np.bool_, st.integers(0, 50)))
def test_runs_rebuild_the_mask(mask: np.ndarray) -> None:
    rebuilt = np.zeros_like(mask)
    found = runs(mask).tolist()
    for start, stop in found:
        assert start < stop
        rebuilt[start:stop] = True
    np.testing.assert_array_equal(rebuilt, mask)
    assert all(a[1] < b[0] for a, b in pairwise(found))
    assert longest_run(mask) == max((b - a for a, b in found), default=0)


def test_causal_filter_is_the_analytic_step_response() -> None:
    """20 Hz, second order Butterworth, unit step: 1 - sqrt(2) exp(-a t) sin(a t + pi/4), a = w / sqrt(2)."""
    t = (np.arange(2000) + 1) * 1e-4
    found = low_pass(np.ones(2000), cutoff_hz=20.0, sample_hz=1e4, zero_phase=False)
    a = 2 * np.pi * 20 / np.sqrt(2)
    np.testing.assert_allclose(found, 1 - np.sqrt(2) * np.exp(-a * t) * np.sin(a * t + np.pi / 4), atol=6e-3)


def test_on_samples_follow_a_step_with_the_filter_delay() -> None:
    contact = find_contact(make_recording(normal={"right_forearm": hold(3.0, 1.0, 2.0, 5.0)}))
    ((start, stop),) = runs(contact.on[:, contact.target]).tolist()
    # The step response reaches 0.5 / 5 within 5 ms and falls under 0.25 / 5 about 20 ms after the step's end.
    assert 0 <= start * DT - 1.0 <= 0.006
    assert 0.015 <= stop * DT - 2.0 <= 0.030


def test_valid_contact_needs_fifty_milliseconds_of_any_segment() -> None:
    tap = hold(3.0, 1.0, 1.010, 3.0)
    assert find_contact(make_recording(normal={"right_hand": tap})).on.any()
    assert not find_contact(make_recording(normal={"right_hand": tap})).valid
    off_target = find_contact(make_recording(normal={"left_foot": hold(3.0, 1.0, 1.2, 3.0)}))
    assert off_target.valid


def test_reported_region_is_the_target_if_touched_else_the_largest_impulse() -> None:
    strong, weak = hold(3.0, 1.0, 2.0, 20.0), hold(3.0, 1.0, 2.0, 2.0)

    def reported(**normal: np.ndarray) -> str | None:
        contact = find_contact(make_recording(normal=normal))
        return None if contact.reported is None else contact.segments[contact.reported]

    assert reported(right_forearm=weak, right_hand=strong) == "right_forearm"
    assert reported(pelvis=weak, right_hand=strong) == "right_hand"
    knock, rest = hold(3.0, 1.0, 1.1, 20.0), hold(3.0, 1.0, 2.0, 5.0)
    assert reported(pelvis=knock, right_hand=rest) == "right_hand", "2 N s at 20 N against 5 N s at 5 N"
    assert reported(pelvis=rest, right_hand=knock) == "pelvis"
    assert reported(right_forearm=hold(3.0, 1.0, 2.0, 0.4)) is None
    assert reported() is None


def test_a_knock_that_is_over_before_the_filter_sees_it_is_reported_and_scored() -> None:
    knock = hold(3.0, 1.0, 1.002, 28.0)
    contact = find_contact(make_recording(normal={"right_hand": knock}))
    assert contact.impulse_ns.sum() == 0, "else this is no such knock"
    assert contact.reported is not None
    assert contact.segments[contact.reported] == "right_hand"
    assert len(contact.force_in_window) > 0
    score = score_recording(make_recording(normal={"right_hand": knock}))
    assert score.peak_force_n["right_hand"] == pytest.approx(28.0)


def test_region_share_is_the_share_of_impulse() -> None:
    both = {"right_forearm": hold(3.0, 1.0, 2.0, 9.0), "right_hand": hold(3.0, 1.0, 2.0, 3.0)}
    share = find_contact(make_recording(normal=both)).region_share
    assert share is not None
    assert abs(share - 0.75) < 0.002
    assert find_contact(make_recording()).region_share is None


def test_episodes_join_gaps_of_a_second_and_no_more() -> None:
    def count(second_start: float) -> int:
        signal = hold(6.0, 1.0, 2.0, 5.0) + hold(6.0, second_start, 5.0, 5.0)
        return len(episodes(find_contact(make_recording(duration=6.0, normal={"right_forearm": signal}))))

    assert count(2.95) == 1
    assert count(3.1) == 2


@pytest.mark.parametrize(("gap", "expected"), [(500, 1), (501, 2)])
def test_a_gap_of_a_second_itself_is_joined(gap: int, expected: int) -> None:
    contact = find_contact(make_recording())
    on = np.zeros(1500, bool)
    on[100:200] = on[200 + gap : 900] = True
    assert len(episodes(replace(contact, neighbourhood_on=on))) == expected


def test_neighbourhood_holds_across_segments() -> None:
    handed_over = {"right_hand": hold(3.0, 1.0, 1.5, 5.0), "right_forearm": hold(3.0, 1.5, 2.0, 5.0)}
    contact = find_contact(make_recording(normal=handed_over))
    assert longest_run(contact.neighbourhood_on) * DT > 1.0
    assert not find_contact(make_recording(normal={"head": hold(3.0, 1.0, 2.0, 5.0)})).neighbourhood_on.any()


def test_steps_are_not_rounded_up_by_binary_fractions() -> None:
    assert [steps(s, DT) for s in (0.5, 1.0, 0.05, 0.051)] == [250, 500, 25, 26]
    assert 0.035 / 0.005 > 7
    assert steps(0.035, 0.005) == 7
    assert len(seconds(3.0)) == 1500


def test_contact_fades_at_the_lower_threshold() -> None:
    """Between 0.25 and 0.5 N contact stays on but does not begin. A larger step would undershoot in the filter."""
    fading = hold(3.0, 1.0, 1.5, 1.0) + hold(3.0, 1.5, 2.5, 0.35)
    contact = find_contact(make_recording(normal={"right_forearm": fading}))
    assert abs(longest_run(contact.on[:, contact.target]) * DT - 1.5) < 0.04
    assert not find_contact(make_recording(normal={"right_forearm": hold(3.0, 1.0, 2.5, 0.35)})).on.any()


def test_nothing_that_metrics_share_can_be_written_to() -> None:
    contact = find_contact(replace(touch(seed=0)))
    shared = {
        name: value
        for name, value in (*vars(contact).items(), *contact.recording.arrays.items())
        if isinstance(value, np.ndarray)
    }
    assert len(shared) > 20
    for name, array in shared.items():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        assert not array.flags.writeable, name


# The words for a press that does not count as contact.


def pressed(force: float, seconds: float, *, on_n: float = 0.5, segment: str = "right_forearm") -> Recording:
    contact = PROTOCOL.contact.model_copy(update={"on_n": on_n})
    protocol: Protocol = PROTOCOL.model_copy(update={"contact": contact})
    at = (0.0, 0.0, SIZE["forearm"][2] + 0.005)
    return make_recording(
        "T1",
        duration=4.0,
        normal={segment: hold(4.0, 1.0, 1.0 + seconds, force)},
        protocol=protocol,
        targets_in_region=[(0.1, at)],
    )


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        (pressed(0.3, 1.7), "pressed the right forearm for 1.7 s with at most 0.3 N; contact counts from 0.5 N"),
        (pressed(0.7, 0.5, on_n=0.8), "pressed the right forearm for 0.5 s with at most 0.7 N; contact counts from"),
        (pressed(0.02, 0.1), "pressed the right forearm for 0.1 s with less than 0.05 N; contact counts"),
        (pressed(0.4, 1.0, segment="abdomen"), "pressed the abdomen for 1.0 s with at most 0.4 N; contact counts"),
    ],
)
def test_a_press_below_the_threshold_is_reported_with_it(recording: Recording, words: str) -> None:
    assert (faint_press(find_contact(recording)) or "").startswith(words)


def test_a_contact_that_is_too_brief_is_reported_with_its_time() -> None:
    contact = find_contact(pressed(30.0, 0.01))
    assert contact.reported is not None
    assert not contact.valid
    message = faint_press(contact) or ""
    assert message.startswith("pressed the right forearm for 0.01 s with at most 30.0 N, of which 0.0")
    assert message.endswith("count as contact (from 0.5 N); a trial needs 0.05 s of it")


def test_there_are_no_words_for_no_press_and_of_contact_that_counts() -> None:
    assert faint_press(find_contact(make_recording())) is None
    assert faint_press(find_contact(touch())) is None


def test_the_evidence_of_a_faint_press_does_not_say_that_nothing_was_touched() -> None:
    score = score_recording(pressed(0.3, 1.7))
    assert score.failure_mode == "no_target_contact"
    assert score.evidence.endswith(
        "the robot pressed the right forearm for 1.7 s with at most 0.3 N; contact counts from 0.5 N."
    )
    untouched = score_recording(pressed(0.0, 1.7))
    assert (untouched.evidence or "").endswith("the robot touched nothing.")
    assert np.isclose(find_contact(pressed(0.3, 1.7)).force_norm.max(), 0.3, rtol=1e-3)


# The Butterworth filters.

SIGNAL = np.random.default_rng(0).normal(size=(400, 3))


@pytest.mark.parametrize(("cutoff_hz", "sample_hz"), [(5.0, 50.0), (20.0, 500.0), (30.0, 250.0), (99.9, 200.0)])
@pytest.mark.parametrize("length", [1, 2, 9, 10, 400])
def test_every_number_is_that_of_scipy(cutoff_hz: float, sample_hz: float, length: int) -> None:
    sections = signal.butter(2, cutoff_hz, fs=sample_hz, output="sos")
    part = SIGNAL[:length]
    once = low_pass(part, cutoff_hz=cutoff_hz, sample_hz=sample_hz, zero_phase=False)
    np.testing.assert_array_equal(once, signal.sosfilt(sections, part, axis=0))
    both = low_pass(part, cutoff_hz=cutoff_hz, sample_hz=sample_hz, zero_phase=True)
    np.testing.assert_array_equal(both, signal.sosfiltfilt(sections, part, axis=0, padlen=min(length - 1, 9)))


@pytest.mark.parametrize("shape", [(400,), (0, 3), (7, 0), (20, 2, 3)])
def test_the_shape_stays(shape: tuple[int, ...]) -> None:
    assert low_pass(np.ones(shape), cutoff_hz=5.0, sample_hz=50.0, zero_phase=True).shape == shape


@pytest.mark.parametrize("cutoff_hz", [0.0, 25.0, 30.0])
def test_a_cutoff_that_no_filter_has_is_refused(cutoff_hz: float) -> None:
    with pytest.raises(ValueError, match="half"):
        low_pass(SIGNAL, cutoff_hz=cutoff_hz, sample_hz=50.0, zero_phase=False)
