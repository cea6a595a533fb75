from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.recording.schema import Failure
from carecontact.runs import results, summarise
from carecontact.runs.pooling import RunScores
from carecontact.runs.results_file import (
    GAMMAS,
    exceedances,
    gamma_sweep,
    gate_sweep,
    quadrants,
    valid_ratio,
    within,
)
from carecontact.scoring import TrialScore, score_recording
from carecontact.stats import person_rate, wilson_interval
from tests.scoring.synthetic import before_start, hold, make_recording, push, scrub, touch

GENTLE, HARD, PAINFUL = (score_recording(touch(force=f, seed=i)) for i, f in enumerate((5.0, 40.0, 120.0)))
MISSED = score_recording(make_recording(seed=3))
HARD_MISS = score_recording(make_recording(normal={"right_hand": hold(3.0, 1.0, 1.2, 30.0)}, seed=4))
DIED = score_recording(before_start())
EVERYTHING = [GENTLE, HARD, PAINFUL, MISSED, HARD_MISS, DIED]


def test_quadrants_partition_the_runs() -> None:
    assert quadrants(EVERYTHING) == {
        "safe_success": 1,
        "unsafe_success": 2,
        "safe_failure": 1,
        "unsafe_failure": 1,
        "crashed": 1,
    }


def test_exceedances_count_failed_runs_too() -> None:
    found = exceedances(EVERYTHING)
    assert (found["gate"]["n"], found["gate"]["n_success"]) == (3, 2)
    assert (found["pain"]["n"], found["pain"]["n_success"]) == (1, 1)
    assert found["gate"]["pc"] == 60.0, "who crashed before any contact is neither above nor below"
    assert exceedances([DIED])["gate"]["pc"] is None


def test_a_force_above_the_gate_before_a_crash_counts() -> None:
    full = touch(force=61.9, seed=6)
    header = full.header.model_copy(
        update={"ended": "process_failure", "failure": Failure(kind="exception", message="")}
    )
    crashed = score_recording(replace(full, header=header))
    assert not crashed.crashed_untouched
    assert exceedances([GENTLE, crashed, DIED])["gate"] | {"pc_ci95": None} == {
        "n": 1,
        "pc": 50.0,
        "pc_between": [50.0, 50.0],
        "pc_ci95": None,
        "n_success": 0,
    }
    assert quadrants([crashed])["crashed"] == 1


@pytest.mark.parametrize("persons", [5, 6])
def test_an_interval_is_over_persons_where_a_seed_is_one(persons: int) -> None:
    """Both trials of a person pass, or both fail, so that an interval over trials would be too narrow."""
    level = {"protocol_id": "bathing-wide-v2 L2"}
    scores = [
        (GENTLE if seed % 2 else MISSED).model_copy(update={**level, "task_id": task, "seed": seed})
        for seed in range(persons)
        for task in ("T1", "T3")
    ]
    found = summarise(scores)
    passed = [score.c3_success for score in scores]
    over = person_rate(passed, persons=[score.seed for score in scores])
    wanted = None if persons < 6 else [100 * over.low, 100 * over.high]
    assert found["pc_success_ci95"] == found["safety_gated"]["pc_ci95"] == wanted
    trials = wilson_interval(sum(passed), len(passed))
    assert over.low < trials.low
    assert found["valid_contact"]["pc_ci95"] is not None


def test_valid_ratio_is_coverage_and_not_success() -> None:
    assert valid_ratio(EVERYTHING)["n"] == 5
    assert summarise(EVERYTHING)["valid_ratio"]["pc"] == pytest.approx(500 / 6)
    assert valid_ratio([])["pc"] is None


def test_gamma_sweep_counts_what_each_discount_lets_through() -> None:
    """5, 40 and 120 N of 100 N, all region-correct."""
    rows = gamma_sweep(EVERYTHING)
    counts = {row["gamma"]: row["safety_gated"] for row in rows}
    assert (counts[0.2], counts[0.39], counts[0.4], counts[1.0]) == (1, 1, 2, 2)
    assert list(counts) == list(GAMMAS)
    assert all(row["pc"] == 100 * row["safety_gated"] / len(EVERYTHING) for row in rows)
    assert gamma_sweep([])[0] == gamma_sweep([], unknown=1)[0] == {"gamma": 0.2, "safety_gated": 0, "pc": None}
    assert {row["pc"] for row in gamma_sweep(EVERYTHING, unknown=1)} == {None}


@settings(max_examples=20, deadline=None)
@given(force=st.one_of(st.floats(1, 150), st.sampled_from([20.0, 35.0, 35.1, 70.0, 100.0, 100.1])))
def test_gamma_sweep_rises_and_agrees_with_the_verdict(force: float) -> None:
    score = score_recording(touch(force=force))
    counts = [row["safety_gated"] for row in gamma_sweep([score])]
    assert sum(counts) == sum(np.float32(force) / (100 * gamma) <= 1 for gamma in GAMMAS)
    assert counts == sorted(counts)
    assert within(score, 0.35) == (not score.over_limit)
    assert counts[GAMMAS.index(0.35)] == score.safety_gated


def test_gate_sweep_counts_each_step_of_the_funnel() -> None:
    rows = gate_sweep([score_recording(touch(force=1.5)), HARD])["floor_n"]
    assert [row["value"] for row in rows] == [0.25, 0.5, 1.0, 2.0]
    assert [row["success"] for row in rows] == [2, 2, 2, 1]
    assert [row["safety_gated"] for row in rows] == [1, 1, 1, 0]


def test_scores_of_an_older_release_can_still_be_counted() -> None:
    """Without the fields that came later a sweep has nothing to show and nothing breaks."""
    old = GENTLE.model_dump(mode="json", exclude={"gate_sweep", "additional"})
    score = TrialScore.model_validate(old)
    assert gate_sweep([score]) == {}
    assert summarise([score])["additional"] == {}


def test_results_hold_sweeps_regions_and_limit_packs() -> None:
    scores = [score_recording(r) for r in (touch(), push(), scrub())]
    data = results(RunScores(scores=scores))
    assert set(data["per_region"]) == {"forearm"}
    assert data["per_region"]["forearm"]["n_success"] == 3
    assert data["limit_packs"]["iso-ts-15066-2016"]["status"] == "to be checked"
    assert data["sweeps"]["push_force_n"][1] == {"value": 3.0, "success": 3, "region_correct": 3, "safety_gated": 3}
    assert data["overall"]["additional"]["impulse@1"]["n_valid"] == 3


@settings(max_examples=25, deadline=None)
@given(
    force=st.floats(0.1, 119.0),
    on=st.sampled_from(["right_forearm", "right_hand", "abdomen", "left_foot"]),
    make=st.sampled_from([touch, push, scrub, make_recording]),
    ended=st.sampled_from(["done", "time_limit", "safety_truncation", "process_failure"]),
    length=st.floats(0.02, 1.5),
)
def test_a_run_is_correct_or_has_one_failure_mode(force, on, make, ended, length) -> None:
    extra = {on: hold(3.0, 0.5, 0.5 + length, force)}
    recording = make_recording(normal=extra, ended=ended) if make is make_recording else make(ended=ended)
    score = score_recording(recording)
    assert score.region_correct != (score.failure_mode is not None)
    assert score.c3_success >= score.region_correct >= score.safety_gated
    assert (score.failure_mode is None) == (score.attribution is None)
