"""A run is incomplete where a planned trial has no verdict, and no rate of it is a number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.recording import write_recording
from carecontact.reports.compare.baselines import beside_baselines
from carecontact.runs import read_results, results, score_run, write_scores
from carecontact.runs.aggregate import rate
from carecontact.runs.identity import Identity
from carecontact.runs.manifest import write_manifest
from carecontact.runs.pooling import unjudged
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores
from carecontact.stats import wilson_interval
from tests.reports.synthetic_run import FAILED, NO_CONTACT, make_score
from tests.scoring.synthetic import touch

HARNESS = NO_CONTACT | {"ended": "harness_error", "failure_message": "no GPU\n\nTraceback"}


def test_each_planned_trial_without_a_verdict_has_one_reason() -> None:
    scores = [make_score("T1", 0), make_score("T1", 1, **HARNESS)]
    found = unjudged(
        scores,
        skipped={"T1-s002.h5": "truncated", "copy.h5": "holds trial T1-s000", "T1-s000.H5": "must end in .h5"},
        missing=["T1-s002", "T1-s003", "T1-s000"],
        elsewhere=["T1-s004", "T1-s001"],
    )
    assert found == {
        "T1-s001": "the harness failed: no GPU\n\nTraceback",
        "T1-s002": "its recording cannot be scored: truncated",
        "T1-s003": "no recording",
        "T1-s004": "in another part of the run",
    }


@pytest.mark.parametrize(("k", "n", "unknown"), [(3, 4, 2), (0, 3, 6), (5, 5, 1)])
def test_a_rate_goes_from_all_unknown_failed_to_all_passed(k: int, n: int, unknown: int) -> None:
    found = rate(k, n, unknown=unknown)
    assert (found["n"], found["pc"]) == (k, None)
    assert found["pc_between"] == pytest.approx([100 * k / (n + unknown), 100 * (k + unknown) / (n + unknown)])
    low, high = wilson_interval(k, n + unknown).low, wilson_interval(k + unknown, n + unknown).high
    assert found["pc_ci95"] == pytest.approx([100 * low, 100 * high])
    assert rate(k, n)["pc_between"] == pytest.approx([100 * k / n] * 2)


def test_a_part_of_a_run_is_incomplete_and_stays_so_in_its_results(tmp_path: Path) -> None:
    """Parts 1 and 2 of a run of two trials: each knows of the other."""
    first, second = touch(seed=0), touch(seed=1)
    identity = Identity(policy_sha256=None, versions={}, sha256={})
    whole = [r.header.spec.trial_id for r in (first, second)]
    write_recording(first, tmp_path / "T1-s000.h5")
    write_manifest([first.header.spec], out=tmp_path, identity=identity, purpose="run", whole=whole)
    run = read_scores(tmp_path, rescore=True)
    assert run.unjudged == {"T1-s001": "in another part of the run"}
    write_scores(tmp_path, run)
    stored = read_results(tmp_path / "results.json")
    assert stored.incomplete == run.incomplete == "incomplete, 1 of 2 planned trials have a verdict"
    assert results(stored)["overall"]["pc_success_between"] == [50.0, 100.0]
    write_recording(second, tmp_path / "T1-s001.h5")
    write_manifest([second.header.spec], out=tmp_path, identity=identity, purpose="run")
    assert read_scores(tmp_path, rescore=True).incomplete == ""


def test_a_recording_that_cannot_be_scored_does_not_leave_the_count(tmp_path: Path) -> None:
    broken = touch(seed=1)
    broken.arrays["scorer/tcp_speed"][3] = float("nan")
    write_recording(touch(seed=0), tmp_path / "T1-s000.h5")
    write_recording(broken, tmp_path / "T1-s001.h5")
    run = score_run(tmp_path)
    assert results(run)["per_task"]["T1"]["n_planned"] == 2
    assert {row["pc"] for row in results(run)["sweeps"]["gamma"]} == {None}
    assert results(run)["overall"]["exceedances"]["gate"]["pc_between"] == [0.0, 50.0]
    assert results(run)["overall"]["valid_ratio"]["pc_between"] == [50.0, 100.0]
    assert results(run)["per_region"]["forearm"]["pc_success_between"] == [50.0, 100.0]
    assert run.unjudged["T1-s001"].startswith("its recording cannot be scored: T1-s001: scorer/tcp_speed holds nan")


def test_beside_an_incomplete_run_there_are_counts_and_no_differences() -> None:
    hover = RunScores(scores=[make_score("T1", seed, policy="hover", **FAILED) for seed in range(6)])
    method = RunScores(scores=[make_score("T1", seed) for seed in range(6)])
    assert beside_baselines(method, [hover]).baselines[0].above is not None
    found = beside_baselines(replace(method, missing=("T1-s006",)), [hover])
    assert found.baselines[0].above is None
    with pytest.raises(ConfigError, match=r"--baseline: hover is incomplete, 6 of 7 planned trials have a verdict"):
        beside_baselines(method, [replace(hover, missing=("T1-s006",))])
