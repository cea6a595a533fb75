from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import ARRAYS, SCHEMA_VERSION, SEGMENTS, Recording
from carecontact.scoring import METRICS, Metric, metric, score_recording
from carecontact.scoring.contact import Contact, find_contact
from carecontact.scoring.metrics.metric import checked_metrics
from carecontact.scoring.result import MEASURED
from carecontact.scoring.score import measure_all
from tests.scoring.synthetic import JOINT_RANGE, before_start, hold, make_recording, push, scrub, seconds, touch

FAST = settings(max_examples=15, deadline=None)
SCORER_STREAMS = sorted(
    k for k, v in touch().arrays.items() if k.startswith("scorer/") and v.dtype.kind == "f" and v.size
)


@pytest.mark.parametrize("row", [METRICS[m] for m in METRICS], ids=list(METRICS))
def test_every_metric_keeps_the_contract(row: Metric) -> None:
    assert METRICS[row.id] is row
    assert row.id.rpartition("@")[2].isdigit()
    assert row.title
    assert row.unit
    for recording in (touch(), push(), scrub(), make_recording(), before_start(), make_recording(ended="time_limit")):
        before = {name: array.copy() for name, array in recording.arrays.items()}
        value = row.compute(find_contact(recording))
        assert value is None or (isinstance(value, float) and np.isfinite(value))
        assert row.compute(find_contact(recording)) == value
        for name, array in before.items():
            np.testing.assert_array_equal(recording[name], array, err_msg=f"{row.id} changed {name}")


@pytest.fixture
def registered() -> Iterator[None]:
    """Whatever a test registers is gone after it."""
    before = dict(METRICS.items())
    yield
    METRICS._rows.clear()
    METRICS._rows.update(before)


def test_a_decorated_function_is_a_metric_and_stays_a_function(registered: None) -> None:
    @metric("mean_force@1", title="Mean force", unit="N", better="lower")
    def mean_force(contact: Contact) -> float | None:
        return float(contact.force_in_window.mean()) if contact.valid else None

    contact = find_contact(touch())
    row = METRICS["mean_force@1"]
    assert mean_force(contact) == row.compute(contact) == pytest.approx(4.9, abs=0.1)
    score = score_recording(touch())
    assert score.additional["mean_force@1"] == row.of(score) == mean_force(contact)
    assert "mean_force" not in score.metric_versions


def test_one_computation_fills_all_its_fields() -> None:
    contact = find_contact(push())
    found, score = METRICS["C2@1"].fill(contact), score_recording(push())
    assert len(found) == 5
    assert found == {name: getattr(score, name) for name in found}
    assert METRICS["C2@1"].compute(contact) == METRICS["C2@1"].of(score) == score.c2_joint_margin_rad
    assert METRICS["C2@1"].pooled([score, score_recording(touch())]) == [score.c2_joint_margin_rad]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"id_": "grip"}, "NAME@VERSION"),
        ({"id_": "grip@1", "field": "grip_n"}, "TrialScore has no field 'grip_n'"),
        ({"id_": "grip@1", "field": "safety_gated"}, "TrialScore has no field 'safety_gated' that a metric fills"),
        ({"id_": "grip@1", "better": "more"}, "better: expected one of higher, lower, neither; got 'more'"),
        ({"id_": "grip@1", "pool": "tap"}, "pool: expected None, moving or a tuple of actions; got 'tap'"),
        ({"id_": "grip@1", "unit": ""}, "unit: expected a text, 1 for a plain number; got ''"),
        ({"id_": "grip@1", "digits": 1.5}, "digits: expected None, or a number from 0 up; got 1.5"),
        ({"id_": "grip@1", "matters": "much"}, "matters: expected None, or above 0; got 'much'"),
        ({"id_": "grip@1", "order": None}, "order: expected a whole number; got None"),
        ({"id_": "grip@1", "better": "neither", "matters": 1.0}, "matters needs a direction"),
        ({"id_": "C1@1"}, "registered twice"),
    ],
)
def test_a_wrong_description_is_refused(registered: None, arguments: dict[str, Any], message: str) -> None:
    assert "C1@1" in METRICS
    with pytest.raises(ConfigError, match=message):
        metric(**{"title": "Grip", "unit": "N", "better": "lower"} | arguments)(lambda contact: 0.0)


def test_two_metrics_cannot_fill_one_field(registered: None) -> None:
    metric("C5@2", title="Force stability", unit="N", better="lower", field="c5_force_sd_n")(lambda contact: 0.0)
    with pytest.raises(ConfigError, match=r"metric C5@2: another metric fills the field 'c5_force_sd_n'"):
        score_recording(touch())


def test_shipped_metrics_fill_every_field_that_is_theirs() -> None:
    filled, _ = measure_all(find_contact(push()))
    assert sorted(filled) == sorted(MEASURED)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("much", "returned 'much' in trial T1-s000; expected a number, or None for NA"),
        (np.zeros((2, 1)), r"returned array\(\[\[0\.\], \[0\.\]\]\) in trial T1-s000; expected a number"),
        (ValueError("no"), r"failed in trial T1-s000: ValueError: no \(test_metrics\.py, line \d+\)"),
    ],
)
def test_a_metric_that_measures_no_number_is_named(registered: None, answer: Any, message: str) -> None:
    @metric("grip@1", title="Grip", unit="N", better="lower")
    def grip(contact: Contact) -> Any:
        if isinstance(answer, Exception):
            raise answer
        return answer

    with pytest.raises(ConfigError, match=f"^metric 'grip@1' {message}"):
        score_recording(touch())


def test_a_number_out_of_range_is_the_fault_of_the_package_whose_metric_it_is(
    registered: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    metric("grip@1", title="Grip", unit="N", better="lower")(lambda contact: float("nan"))
    with pytest.raises(RecordingError, match=r"T1-s000: grip@1 comes out as nan"):
        score_recording(touch())
    monkeypatch.setattr(METRICS, "package", {"grip@1": "grips"}.get)
    with pytest.raises(ConfigError, match="metric 'grip@1' returned nan in trial T1-s000; return None for NA"):
        score_recording(touch())


def test_a_pool_names_registered_actions(registered: None) -> None:
    metric("grip@1", title="Grip", unit="N", better="lower", pool=("tapp",))(lambda contact: 0.0)
    with pytest.raises(ConfigError, match=r"metric 'grip@1': pool: no action named 'tapp'; valid: .*push, .*touch"):
        checked_metrics()


def test_a_metric_has_the_name_of_its_id(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METRICS._rows, "C1@7", METRICS["C1@1"])
    with pytest.raises(ConfigError, match="metric 'C1@7': its id is 'C1@1'; give its entry point the same name"):
        checked_metrics()


def test_metrics_are_na_without_contact() -> None:
    untouched, unborn = find_contact(make_recording()), find_contact(before_start())
    answers = {m: (METRICS[m].compute(untouched), METRICS[m].compute(unborn)) for m in ("C1@1", "C2@1", "C3@1", "C5@1")}
    assert answers == {"C1@1": (None, None), "C2@1": (None, None), "C3@1": (0.0, 0.0), "C5@1": (None, None)}
    assert METRICS["C4@1"].compute(untouched) == 1.0
    assert METRICS["C4@1"].compute(unborn) is None


def test_c1_is_the_largest_unfiltered_force_of_the_window() -> None:
    signal = hold(3.0, 1.0, 2.0, 5.0)
    signal[750] = 42.0  # one physics step
    score = score_recording(make_recording(normal={"right_forearm": signal}))
    assert score.c1_peak_force_n == 42.0
    assert score.c1_peak_contact_sum_n == 42.0
    assert 5.0 < score.c1_peak_filtered_n < 40.0
    assert score.over_limit == {"right_forearm": pytest.approx(42 / 35)}


def test_a_lone_spike_cannot_hide_from_the_safety_gate() -> None:
    """The causal filter opens the window a step after a short knock; the safety gate looks at the whole trial."""
    signal = hold(3.0, 2.0, 2.5, 1.0)
    signal[100] = 36.0
    score = score_recording(make_recording(normal={"right_forearm": signal}))
    assert score.peak_force_n["right_forearm"] == 36.0
    assert score.c1_peak_any_segment_n == 36.0
    assert "right_forearm" in score.over_limit


@FAST
@given(start=st.integers(0, 600), force=st.floats(1, 60), ripple=st.floats(0, 0.5))
def test_c1_and_c5_do_not_depend_on_when_contact_happens(start: int, force: float, ripple: float) -> None:
    pulse = force * (1 + ripple * np.sin(np.arange(400) / 7))

    def at(first: int) -> Recording:
        signal = np.zeros(1500)
        signal[first : first + 400] = pulse
        return make_recording(normal={"right_forearm": signal})

    early, late = score_recording(at(0)), score_recording(at(start))
    assert early.c1_peak_force_n == late.c1_peak_force_n
    assert early.c5_force_sd_n == pytest.approx(late.c5_force_sd_n, rel=1e-9)


@FAST
@given(force=st.floats(1, 100))
def test_c5_is_zero_for_constant_force(force: float) -> None:
    """Contact to the end of the trial, so that the filter's tail adds no zero samples."""
    score = score_recording(make_recording(normal={"right_forearm": hold(3.0, 1.0, 3.0, force)}))
    assert score.c5_force_sd_n == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("force", "duration", "published"), [(30.0, 0.5, 6.5), (30.0, 0.2, 9.6), (5.0, 1.0, 0.76)])
def test_c5_of_a_constant_force_that_is_released(force: float, duration: float, published: float) -> None:
    """The window opens when the filter's step response reaches 0.5 N and closes when its tail falls under 0.25 N: for
    that time its samples are 0, and a share p of zeros beside a constant F has SD F sqrt(p (1 - p))."""
    a = 2 * np.pi * 20 / np.sqrt(2)
    t = np.arange(0, 3 * np.pi / 4 / a, 1e-6)
    tail = np.sqrt(2) * np.exp(-a * t) * np.sin(a * t + np.pi / 4)  # of a unit step, second order Butterworth
    opened = t[np.argmax(1 - tail >= 0.5 / force)]
    zeros = t[np.argmax(tail < 0.25 / force)]
    share = zeros / (duration - opened + zeros)
    score = score_recording(make_recording(normal={"right_forearm": hold(3.0, 1.0, 1.0 + duration, force)}))
    assert score.c5_force_sd_n == pytest.approx(force * np.sqrt(share * (1 - share)), rel=0.04)
    assert score.c5_force_sd_n == pytest.approx(published, rel=0.01), "what docs/scores.md says"


def test_c5_is_the_population_sd() -> None:
    """A window of 28 samples, half of them 1 N above their mean and half below; with n - 1 it would be 1.018 N."""
    t = seconds(3.0)
    ripple = np.where(t > 2.942, 10.0 + np.where(np.arange(len(t)) % 2, 1.0, -1.0), 0.0)
    recording = make_recording(normal={"right_forearm": ripple})
    assert find_contact(recording).window.sum() == 28
    assert score_recording(recording).c5_force_sd_n == pytest.approx(1.0, abs=1e-6)


def test_c5_of_a_sine_is_its_amplitude_over_root_two() -> None:
    t = seconds(3.0)
    signal = np.where(t > 1.0, 10 + 4 * np.sin(2 * np.pi * 5 * t), 0.0)
    score = score_recording(make_recording(normal={"right_forearm": signal}))
    assert score.c5_force_sd_n == pytest.approx(4 / np.sqrt(2), rel=0.01)


@FAST
@given(over=st.floats(-0.4, 0.4))
def test_c2_is_negative_exactly_beyond_the_range(over: float) -> None:
    joints = np.ones((1500, 2))
    joints[700, 1] = JOINT_RANGE[1][1] + over
    score = score_recording(push(joints=joints))
    assert score.c2_joint_margin_rad == pytest.approx(-over, abs=1e-6)
    assert score.c2_joint == "right_elbow_flexion"
    assert score.c2_time_s == pytest.approx(701 * 0.002)
    assert score.c2_settled_margin_rad == pytest.approx(1.0)
    assert score.c2_change_rad == pytest.approx(-over - 1.0, abs=1e-6)


def test_c2_also_knows_the_lower_end() -> None:
    joints = np.ones((1500, 2))
    joints[:, 0] = np.linspace(1.0, -0.6, 1500)
    assert score_recording(push(joints=joints)).c2_joint_margin_rad == pytest.approx(-0.1, abs=1e-6)


def test_c2_2_is_the_share_that_the_worst_joint_used_up() -> None:
    """Settled at 1.0 in -0.5 to 2.5 and in 0 to 2.4: one joint keeps 0.3 of 1.5, the other 0.5 of 1."""
    joints = np.ones((1500, 2))
    joints[600, 0] = JOINT_RANGE[0][1] - 0.3
    joints[900, 1] = JOINT_RANGE[1][0] + 0.5
    assert METRICS["C2@2"].compute(find_contact(push(joints=joints))) == pytest.approx(1 - 0.3 / 1.5, abs=1e-6)
    joints[600, 0] = JOINT_RANGE[0][1] + 0.3
    assert METRICS["C2@2"].compute(find_contact(push(joints=joints))) == pytest.approx(1.2, abs=1e-6)
    assert METRICS["C2@2"].compute(find_contact(push(joints=np.ones((1500, 2))))) == 0.0


def test_end_stop_torque_needs_the_reaction_and_is_its_largest_size() -> None:
    joints = np.ones((1500, 2))
    joints[600, 0] = JOINT_RANGE[0][1] + 0.1
    reaction = np.zeros((1500, 2), np.float32)
    reaction[600, 0] = -7.5
    recording = push(joints=joints)
    assert METRICS["end_stop_torque@1"].compute(find_contact(recording)) is None
    recording.arrays["scorer/human_joint_reaction"] = reaction
    assert METRICS["end_stop_torque@1"].compute(find_contact(recording)) == 7.5


@FAST
@given(moving=st.integers(0, 1500))
def test_c4_is_the_share_of_moving_steps(moving: int) -> None:
    speed = np.zeros(1500)
    speed[:moving] = 0.02
    assert score_recording(make_recording(speed=speed)).c4_motion_activity == moving / 1500


def test_c4_counts_rotation_and_not_creep() -> None:
    turning = {"scorer/tcp_rotation_speed": np.full(1500, 0.1, np.float32)}
    assert score_recording(make_recording(speed=0.0, extra=turning)).c4_motion_activity == 1.0
    assert score_recording(make_recording(speed=0.004)).c4_motion_activity == 0.0


@pytest.mark.parametrize("path", SCORER_STREAMS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_broken_stream_is_named_and_never_scored(path: str, value: float) -> None:
    recording = touch()
    broken = recording[path].copy()
    broken[(-1,) * broken.ndim] = value
    recording.arrays[path] = broken
    with pytest.raises(RecordingError, match=path):
        score_recording(recording)


def test_a_gap_in_time_is_named() -> None:
    recording = touch()
    recording.arrays["scorer/time_s"] = recording["scorer/time_s"] + (np.arange(1500) > 700) * 0.5
    with pytest.raises(RecordingError, match="after sample 700"):
        score_recording(recording)


def test_score_is_a_pure_function() -> None:
    first, second = score_recording(scrub()), score_recording(scrub())
    assert first.model_dump_json() == second.model_dump_json()
    with_wall = score_recording(scrub(extra={"wall/act_s": np.ones(3)}))
    assert with_wall.model_dump_json() == first.model_dump_json()


def test_every_segment_has_a_limit() -> None:
    everything = {s: hold(3.0, 1.0, 2.0, 20.0) for s in SEGMENTS}
    score = score_recording(make_recording(normal=everything))
    assert set(score.peak_force_n) == set(SEGMENTS)
    assert score.over_limit == {}
    over = score_recording(make_recording(normal={s: hold(3.0, 1.0, 2.0, 22.0) for s in SEGMENTS})).over_limit
    limbs = {f"{side}_{name}" for side in ("right", "left") for name in ("forearm", "upper_arm")}
    assert set(over) == set(SEGMENTS) - limbs, "segments without an entry take the strictest limit, 21 N"


def test_indentation_beyond_the_measured_range_is_counted_under_contact_only() -> None:
    """The forearm was measured to 5 mm: deep for half of the touch, and deep again where nothing touches."""
    depth = np.full((150, 3), 0.003, np.float32)
    depth[50:75, 0] = 0.008
    depth[120:, 0] = 0.009
    score = score_recording(touch(extra={"scorer/indentation_m": depth}))
    assert score.indentation_m == pytest.approx(0.009)
    assert score.extrapolated_share == pytest.approx(0.5, abs=0.02)
    assert score_recording(make_recording()).extrapolated_share is None
    contact = find_contact(touch(extra={"scorer/indentation_m": depth}))
    for step, share in ((598, None), (599, 1.0), (600, None)):
        on = np.zeros_like(contact.on)
        on[step, contact.target] = True
        found = METRICS["beyond_calibrated@2"].compute(replace(contact, on=on))
        assert found == share, "the last step of a control period decides whether it counts"


def test_a_glide_deeper_than_15_mm_counts_as_beyond_the_tissue_and_a_press_as_deep_does_not() -> None:
    """The abdomen was measured to 22 mm, but only to 15 mm does a moving tool feel what it should."""
    deep = {"scorer/indentation_m": np.full((150, 3), 0.018, np.float32)}
    for speed, share in ((0.02, 1.0), (0.0, 0.0)):
        extra = {**deep, "scorer/tcp_speed": np.full(1500, speed, np.float32)}
        recording = make_recording("T6", normal={"abdomen": hold(3.0, 1.0, 2.0, 8.0)}, extra=extra)
        assert METRICS["beyond_calibrated@2"].compute(find_contact(recording)) == share


def test_impulse_is_force_times_time() -> None:
    score = score_recording(touch(force=5.0))
    assert score.impulse_ns == pytest.approx(5.0, rel=0.01)
    assert score.contact_s == pytest.approx(1.0, abs=0.03)


PAGE = (Path(__file__).parents[2] / "docs" / "scores.md").read_text()
ROWS = dict(re.findall(r"^\| `([A-Za-z0-9_]+@\d+)` \| ([^|]+) \|", PAGE, re.MULTILINE))


def test_the_table_lists_every_metric_with_its_unit() -> None:
    assert ROWS == {id_: METRICS[id_].unit for id_ in METRICS}


@pytest.mark.parametrize("group", sorted({path.partition("/")[0] for path in ARRAYS}))
def test_the_layout_lists_every_group(group: str) -> None:
    assert f"`{group}/`" in PAGE


def test_the_page_names_the_schema() -> None:
    assert f"`{SCHEMA_VERSION}`" in PAGE
