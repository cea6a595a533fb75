"""The audit's part for time, on recordings whose wall times are made up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.audit.wall_time import Times, audit_time, separation, times_of
from carecontact.cli import main
from carecontact.recording import Recording, write_recording
from carecontact.running.pace import BETWEEN, PACED
from tests.scoring.synthetic import touch

ACTS = 60


def timed(between: Callable[[np.ndarray], np.ndarray], *, pace: float | None = None) -> Recording:
    """A touch of which every act lasts one period, with the wall times that ``between`` makes of contact (n,)."""
    made = touch(seed=0)
    steps = made["scorer/time_s"]
    shown = np.linspace(0.0, steps[-1], ACTS)
    arrays = {
        **made.arrays, "policy/observation_time_s": shown, "policy/observation_sha256": np.zeros((ACTS, 32), "u1"),
        "actions/time_s": shown, "actions/observation_index": np.arange(ACTS, dtype="i4"),
        "actions/pose_tcp_in_base": np.full((ACTS, 7), np.nan), "actions/stiffness": np.ones((ACTS, 2)),
    }  # fmt: skip
    contact = times_of(replace(made, arrays={**arrays, BETWEEN: np.zeros(ACTS - 1)})).contact
    assert 5 < contact.sum() < ACTS - 5
    kept = {BETWEEN: between(contact)} | ({} if pace is None else {PACED: np.array([pace, 3.0])})
    return replace(made, arrays={**arrays, **kept})


def telling(contact: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).normal(0.2, 0.01, len(contact)) + 0.03 * contact


def silent(contact: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).normal(0.2, 0.01, len(contact))


def test_what_an_interval_is() -> None:
    made = timed(silent)
    touched = made["scorer/normal_force"].max(1) > 0
    shown, steps = made["policy/observation_time_s"], made["scorer/time_s"]
    times = times_of(made)
    for k in range(ACTS - 1):
        during = (steps >= shown[k]) & (steps < shown[k + 1])
        assert times.contact[k] == touched[during].any()
    two = {**made.arrays, "actions/observation_index": np.minimum(np.arange(ACTS), 1).astype("i4")}
    per_period = times_of(replace(made, arrays=two)).per_period_s
    assert per_period == pytest.approx(made[BETWEEN][:2] / [1, ACTS - 1])
    assert len(times_of(touch(seed=0)).contact) == 0, "a recording without wall times"


def test_the_area_under_the_curve() -> None:
    slow = Times(per_period_s=np.array([1.0, 2.0, 3.0, 4.0]), contact=np.array([False, False, True, True]))
    mixed = Times(per_period_s=np.array([1.0, 2.0, 2.0, 10.0]), contact=np.array([True, False, True, False]))
    assert separation([slow]).auc == 1.0
    assert separation([mixed]).auc == pytest.approx(0.5 / 4)
    # Within each trial: one on a slow machine, without contact, says nothing about the others.
    idle = Times(per_period_s=np.full(50, 99.0), contact=np.zeros(50, bool))
    assert separation([slow, mixed, idle]).auc == pytest.approx(4.5 / 8)
    assert np.isnan(separation([idle]).auc)
    assert not separation([idle]).tells


@pytest.mark.parametrize(
    ("between", "pace", "passed", "says"),
    [
        (telling, None, True, "without a pace: wall time tells contact (AUC 1.00"),
        (silent, None, True, "without a pace: wall time does not tell contact (AUC 0."),
        (silent, 0.2, True, "with a pace: wall time does not tell contact"),
        (telling, 0.2, False, "3 observations came late: give a longer --pace"),
    ],
)
def test_only_a_run_that_claims_a_pace_can_fail(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    between: Callable[[np.ndarray], np.ndarray],
    pace: float | None,
    passed: bool,
    says: str,
) -> None:
    recording = timed(between, pace=pace)
    part = audit_time([recording])
    assert part.passed == passed
    write_recording(recording, tmp_path / f"{recording.header.spec.trial_id}.h5")
    assert main(["verify", "leaks", "--run", str(tmp_path)]) == (0 if passed else 1)
    assert says in capsys.readouterr().out


def test_a_paced_run_without_contact_has_nothing_to_examine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = timed(silent, pace=0.2)
    quiet = {**recording.arrays, "scorer/normal_force": np.zeros_like(recording["scorer/normal_force"])}
    write_recording(replace(recording, arrays=quiet), tmp_path / f"{recording.header.spec.trial_id}.h5")
    assert main(["verify", "leaks", "--run", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("none  time")
    assert "with a pace: nothing to examine, because no trial has intervals both with and without contact" in out


def test_what_is_given_with_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "leaks", "--run", "somewhere", "--quick"]) == 2
    assert "--run examines only recordings; leave out --quick" in capsys.readouterr().err
