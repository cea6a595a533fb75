"""Impulse, force rate, exposure and shear work of signals whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import RecordingError
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.protocol.gates import Conduct
from carecontact.recording import SEGMENTS, Recording
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.contact import find_contact
from tests.scoring.synthetic import (
    BASE,
    DT,
    GENTLE,
    REGION_AT,
    SIZE,
    back_and_forth,
    before_start,
    hold,
    make_recording,
    scrub,
    seconds,
    touch,
)

FAST = settings(max_examples=15, deadline=None)
NEED_CONTACT = (
    "impulse@1", "force_rate_p95@1", "exposure_comfort@1", "exposure_gate@1", "exposure_pain@1", "shear_work@1",
    "beyond_calibrated@2", "pain_utilisation@1", "iso_utilisation@1",
)  # fmt: skip


def measure(metric: str, recording: Recording) -> float | None:
    return METRICS[metric].compute(find_contact(recording))


@pytest.mark.parametrize("metric", NEED_CONTACT)
def test_na_without_contact(metric: str) -> None:
    assert measure(metric, make_recording()) is None
    assert measure(metric, before_start()) is None
    assert measure(metric, touch()) is not None


@pytest.mark.parametrize("metric", ["impulse@1", "force_rate_p95@1", "exposure_pain@1", "shear_work@1"])
def test_na_for_a_contact_too_brief_to_be_valid(metric: str) -> None:
    knock = make_recording(normal={"right_forearm": hold(3.0, 2.98, 3.0, 120.0)})
    assert find_contact(knock).touched
    assert measure(metric, knock) is None


def test_impulse_is_force_times_time_over_all_segments() -> None:
    """Contact to the trial's end; the filter opens some steps late."""
    both = {"right_forearm": hold(3.0, 1.0, 3.0, 6.0), "right_hand": hold(3.0, 2.0, 3.0, 4.0)}
    assert measure("impulse@1", make_recording(normal=both)) == pytest.approx(6.0 * 2 + 4.0, rel=0.01)


@FAST
@given(at=st.floats(1.2, 1.8), first=st.floats(1, 30), second=st.floats(1, 30))
def test_impulse_is_additive(at: float, first: float, second: float) -> None:
    """Over segments exactly, and over time up to the steps that the filter opens late and closes late."""
    left, right = hold(3.0, 1.0, at, first), hold(3.0, at, 3.0, second)
    whole = measure("impulse@1", make_recording(normal={"right_forearm": left + right}))
    apart = measure("impulse@1", make_recording(normal={"right_forearm": left, "right_hand": right}))
    alone = [measure("impulse@1", make_recording(normal={"right_forearm": signal})) for signal in (left, right)]
    assert whole is not None
    assert None not in alone
    assert apart == pytest.approx(sum(a for a in alone if a is not None), rel=1e-9)
    assert apart == pytest.approx(whole, abs=20 * DT * max(first, second))


def test_force_rate_of_a_ramp_is_its_slope() -> None:
    t = seconds(3.0)
    assert measure(
        "force_rate_p95@1", make_recording(normal={"right_forearm": np.clip(t - 0.5, 0, None) * 8})
    ) == pytest.approx(8.0, rel=1e-3)


def test_force_rate_of_a_sine() -> None:
    """|cos| is below cos(0.05 pi / 2) for 95 % of a period."""
    amplitude, frequency = 4.0, 5.0
    signal = 10 + amplitude * np.sin(2 * np.pi * frequency * seconds(4.0))
    expected = amplitude * 2 * np.pi * frequency * np.cos(0.05 * np.pi / 2)
    recording = make_recording(duration=4.0, normal={"right_forearm": signal})
    assert measure("force_rate_p95@1", recording) == pytest.approx(expected, rel=0.01)


def test_force_rate_is_zero_for_a_constant_force() -> None:
    assert measure("force_rate_p95@1", make_recording(normal={"right_forearm": np.full(1500, 7.0)})) == pytest.approx(
        0.0, abs=0.5
    )


def test_exposure_counts_the_time_above_each_level() -> None:
    """0.5 s at 12 N, 0.3 s at 40 N and 0.1 s at 120 N on the forearm, whose gate is 35 N and whose limit 100 N."""
    signal = hold(3.0, 0.5, 1.0, 12.0) + hold(3.0, 1.0, 1.3, 40.0) + hold(3.0, 1.3, 1.4, 120.0)
    recording = make_recording(normal={"right_forearm": signal})
    assert measure("exposure_comfort@1", recording) == pytest.approx(0.9, abs=2 * DT)
    assert measure("exposure_gate@1", recording) == pytest.approx(0.4, abs=2 * DT)
    assert measure("exposure_pain@1", recording) == pytest.approx(0.1, abs=2 * DT)


def test_exposure_is_judged_by_each_segments_own_limit() -> None:
    """30 N is within the forearm's gate and beyond the abdomen's; at once they are one time and not two."""
    signal = hold(3.0, 1.0, 2.0, 30.0)
    assert measure("exposure_gate@1", make_recording(normal={"right_forearm": signal})) == 0.0
    both = make_recording(normal={"right_forearm": signal, "abdomen": signal})
    assert measure("exposure_gate@1", both) == pytest.approx(1.0)
    assert measure("exposure_comfort@1", both) == pytest.approx(1.0)


@FAST
@given(peak=st.floats(1, 150), segment=st.sampled_from(SEGMENTS))
def test_exposures_are_ordered(peak: float, segment: str) -> None:
    signal = peak * np.clip(np.sin(2 * np.pi * seconds(3.0)), 0, None)
    recording = make_recording(normal={segment: signal})
    comfort, gate, pain = (measure(f"exposure_{level}@1", recording) or 0.0 for level in ("comfort", "gate", "pain"))
    assert comfort >= gate >= pain
    assert (comfort > 0) == (np.float32(signal.max()) > 10)


def rubbed(friction: float, tcp: np.ndarray, force: np.ndarray, *, drag: np.ndarray | None = None) -> Recording:
    """A tool on the forearm that drags the skin along x with ``friction`` times its normal force."""
    recording = make_recording("T3", duration=len(force) * DT, normal={"right_forearm": force}, tcp_in_region=tcp)
    along = np.sign(np.diff(tcp[:, 0], append=tcp[-1, 0])) if drag is None else drag
    column = SEGMENTS.index("right_forearm")
    recording["scorer/force_human_from_robot_in_world"][:, column, 0] = friction * force * along
    return recording


def test_shear_work_is_friction_force_times_way() -> None:
    """0.3 x 10 N over 0.2 m: 0.6 J. Pressed from the first step, and the filter takes four steps to open."""
    tcp = np.tile([0.0, 0.0, SIZE["forearm"][2]], (1500, 1))
    tcp[:, 0] = np.clip((seconds(3.0) - 1.0) * 0.1, 0, 0.2)
    assert measure("shear_work@1", rubbed(0.3, tcp, np.full(1500, 10.0))) == pytest.approx(0.6, rel=0.005)


def test_there_and_back_adds_up_and_stretching_cancels() -> None:
    tcp = back_and_forth(4.0, "forearm", amplitude=0.05, period=2.0)
    force = np.full(2000, 10.0)
    assert measure("shear_work@1", rubbed(0.3, tcp, force)) == pytest.approx(3.0 * 0.4, rel=0.02)
    spring = tcp[:, 0] / 0.05
    assert measure("shear_work@1", rubbed(0.3, tcp, force, drag=spring)) == pytest.approx(0.0, abs=0.02)


def test_pressing_in_and_carrying_the_arm_are_no_shear() -> None:
    tcp = np.tile([0.0, 0.0, SIZE["forearm"][2]], (1500, 1))
    tcp[:, 2] -= 0.01 * np.clip(seconds(3.0), 0, 1)
    assert measure("shear_work@1", rubbed(0.0, tcp, np.full(1500, 10.0))) == pytest.approx(0.0, abs=1e-9)
    carried = rubbed(0.3, np.tile([0.0, 0.0, SIZE["forearm"][2]], (1500, 1)), np.full(1500, 10.0), drag=np.ones(1500))
    shift = 0.1 * seconds(3.0).astype(np.float32)
    carried["scorer/pose_tcp_in_world"][:, 0] += shift
    carried["scorer/region_pose_in_world"][:, STANDARD_REGIONS.index("forearm"), 0] += shift
    assert measure("shear_work@1", carried) == pytest.approx(0.0, abs=1e-5)


def test_shear_work_turns_with_the_bone() -> None:
    """The bone's x axis points along world y; dragging along world y is dragging along the bone."""
    recording = rubbed(0.3, np.tile([0.0, 0.0, SIZE["forearm"][2]], (1500, 1)), np.full(1500, 10.0))
    column, region = SEGMENTS.index("right_forearm"), STANDARD_REGIONS.index("forearm")
    recording["scorer/region_pose_in_world"][:, region, 3:] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    recording["scorer/pose_tcp_in_world"][:, 1] = REGION_AT["forearm"][1] + 0.1 * seconds(3.0)
    recording["scorer/force_human_from_robot_in_world"][:, column, 1] = 3.0
    assert measure("shear_work@1", recording) == pytest.approx(3.0 * 0.3, rel=0.005)


def test_shear_work_needs_a_region_with_a_frame() -> None:
    assert measure("shear_work@1", make_recording(normal={"right_hand": hold(3.0, 1.0, 2.0, 5.0)})) is None
    assert measure("shear_work@1", make_recording(normal={"right_upper_arm": hold(3.0, 1.0, 2.0, 5.0)})) is not None


def test_beyond_calibrated_is_the_score_that_the_trial_carries() -> None:
    recording = scrub(extra={"scorer/indentation_m": np.full((300, 3), 0.009, np.float32)})
    assert measure("beyond_calibrated@2", recording) == 1.0


# R^2 of force from commands and encoders, for forces that follow from them, that do not, and half of each.

DURATION_S, STIFFNESS = 6.0, 400.0
PERIODS = round(DURATION_S / DT) // 10


def recording(deflection_m: np.ndarray, force_n: np.ndarray, *, damper_ns_m: float = 0.0) -> Recording:
    """Force of each control period, held over its steps; ``deflection_m`` (P,): target below the tool.

    ``damper_ns_m``: the tool goes up and down meanwhile, and its speed times this is added to the force.
    """
    t = (np.arange(10 * PERIODS) + 1) * DT
    height = 0.01 * np.sin(2 * np.pi * t) if damper_ns_m else np.zeros(len(t))
    speed = 0.02 * np.pi * np.cos(2 * np.pi * t) if damper_ns_m else height
    normal = np.repeat(force_n, 10) + damper_ns_m * speed
    made = make_recording(
        "T1", duration=DURATION_S, normal={"right_forearm": normal}, targets_in_region=[(0.0, (0.0, 0.0, 0.0))]
    )
    tool = made["scorer/pose_tcp_in_world"]
    tool[:, 2] += height.astype(np.float32)
    # At a period's last step, where the scorer reads it.
    made["scorer/target_in_base"][:, :3] = tool[9::10, :3] - np.array(BASE[:3], np.float32)
    made["scorer/target_in_base"][:, 2] -= deflection_m.astype(np.float32)
    made["actions/stiffness"][:] = [STIFFNESS, 20.0]
    return made


def r2(of: Recording) -> float | None:
    return METRICS["force_predicted_r2@1"].compute(find_contact(of))


SWING = 0.01 + 0.004 * np.sin(np.arange(PERIODS) / 7)
NOISE = np.random.default_rng(5).normal(size=PERIODS)


def test_a_spring_tells_all() -> None:
    assert r2(recording(SWING, STIFFNESS * SWING)) == pytest.approx(1.0, abs=1e-4)


def test_the_damper_is_known_too() -> None:
    assert r2(recording(SWING, STIFFNESS * SWING, damper_ns_m=20.0)) == pytest.approx(1.0, abs=0.02)


def test_a_force_of_its_own_is_not_predicted() -> None:
    assert r2(recording(SWING, 5 + 0.5 * NOISE)) == pytest.approx(0.0, abs=0.03)


def test_noise_as_large_as_the_signal_leaves_half() -> None:
    spring = STIFFNESS * SWING
    assert r2(recording(SWING, spring + spring.std() * NOISE)) == pytest.approx(0.5, abs=0.1)


def test_na() -> None:
    flat = np.full(PERIODS, 0.01)
    assert r2(recording(flat, STIFFNESS * flat)) is None, "nothing varies"
    assert r2(make_recording()) is None, "no contact"
    assert r2(touch()) is None, "no action"
    brief = make_recording(
        normal={"right_forearm": hold(3.0, 1.0, 1.5, 5.0)}, targets_in_region=[(0.0, (0.0, 0.0, 0.0))]
    )
    assert r2(brief) is None, "25 periods"


def test_a_stiffness_that_is_no_number_is_no_score() -> None:
    broken = recording(SWING, STIFFNESS * SWING)
    broken["actions/stiffness"][:] = np.nan
    assert np.isnan(r2(broken))
    with pytest.raises(RecordingError, match="actions/stiffness holds"):
        score_recording(broken)


@pytest.mark.parametrize(
    ("force_n", "seconds_on", "harmless"), [(20.0, 2.0, 1.0), (36.0, 2.0, 0.0), (36.0, 0.8, None), (20.0, 0.8, None)]
)
def test_harmless_is_said_of_trials_that_touched_for_a_second(
    force_n: float, seconds_on: float, harmless: float | None
) -> None:
    """The gate of the forearm is 35 N."""
    recording = make_recording("T1", normal={"right_forearm": hold(3.0, 0.5, 0.5 + seconds_on, force_n)})
    assert measure("harmless@1", recording) == harmless


def test_a_knock_elsewhere_harms_and_the_protocols_peak_is_a_limit() -> None:
    normal = {"right_forearm": hold(3.0, 0.5, 2.5, 14.0), "head": hold(3.0, 2.6, 2.6 + DT, 22.0)}
    assert measure("harmless@1", make_recording("T1", normal=normal)) == 0.0, "21 N are the strictest gate"
    del normal["head"]
    assert measure("harmless@1", make_recording("T1", normal=normal)) == 1.0
    conduct = {"touch": Conduct(peak_n=13.0)}
    stricter = GENTLE.model_copy(update={"gates": GENTLE.gates.model_copy(update={"conduct": conduct})})
    assert measure("harmless@1", make_recording("T1", normal=normal, protocol=stricter)) == 0.0


def test_severity_weighs_by_time() -> None:
    """A third of the limit for 1 s and two thirds for 1 s are a half; no force at all is none."""
    normal = hold(4.0, 0.5, 1.5, 35.0 / 3) + hold(4.0, 2.0, 3.0, 70.0 / 3)
    recording = make_recording("T1", duration=4.0, normal={"right_forearm": normal})
    assert measure("severity@1", recording) == pytest.approx(0.5, rel=1e-3)
    assert measure("severity@1", make_recording("T1", normal={})) is None
