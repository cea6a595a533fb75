"""R^2 of force from commands and encoders, for forces that follow from them, that do not, and half of each."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.contact import find_contact
from tests.scoring.synthetic import BASE, DT, hold, make_recording, touch

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


def test_a_force_of_its_own_is_not_told() -> None:
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
