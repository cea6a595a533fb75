"""What the terminal shows of scores, at 80 columns."""

from __future__ import annotations

import pytest

from carecontact.cli.score_tables import print_table
from tests.reports.synthetic_run import FAILED, NO_CONTACT, Run, fill, make_score

CRASHED = NO_CONTACT | {"ended": "process_failure", "failure_mode": "process_failure"}
PRESSED = FAILED | {
    "ended": "process_failure", "failure_mode": "process_failure", "over_limit": {"right_forearm": 61.9 / 35},
    "peak_force_n": {"right_forearm": 61.9},
}  # fmt: skip


def shown(scores: list, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "80")
    print_table(scores)
    return capsys.readouterr().out


def test_seven_tasks_fit_80_columns_and_no_name_is_cut(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run()
    fill(run, 0)
    scores = [s.model_copy(update={"additional": {"beyond_calibrated@1": 0.125}}) for s in run.scores]
    told = shown(scores, capsys, monkeypatch)
    assert [line for line in told.splitlines() if len(line) > 80] == []
    assert "…" not in told
    assert "beyond_calibrated@1" in told
    assert "\nT5: 1 insufficient progress\n" in told
    heads = [line.removeprefix("median") for line in told.splitlines() if line.startswith("median")]
    assert " ".join(heads).split() == ["T1", "T2", "T3", "T4", "T5", "T6", "T7", "all"]
    assert all(line.count("of 6") == 1 for line in told.split("successful\n")[1].splitlines() if " of " in line)


def test_a_run_of_crashes_alone_counts_nothing_above_a_limit(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = shown([make_score("T1", 0, **CRASHED)], capsys, monkeypatch)
    assert "crashed: 1" in told
    assert "limit" not in told
    assert "0 of 1" not in told.replace("score: 0 of 1", "")


def test_a_force_above_the_gate_before_a_crash_is_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = [make_score("T1", 0), make_score("T1", 1, **PRESSED), make_score("T1", 2, **CRASHED)]
    told = " ".join(shown(scores, capsys, monkeypatch).split())
    assert "crashed: 2, 1 of them after a force above the safety gate" in told
    assert "share of the pain limit 1 of 2 0" in told


def test_the_gate_for_joints_is_told_where_there_is_one(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flagged = make_score("T1", 1, joints_beyond={}, joints_consumed={"right_elbow": 0.9})
    none = make_score("T1", 0, joints_beyond={}, joints_consumed={})
    told = " ".join(shown([none, flagged], capsys, monkeypatch).split())
    assert (
        "joint beyond the protocol's limit: 0 of 2; a joint flagged because little of its margin was left: 1 of 2"
        in told
    )
    assert "joint" not in shown([make_score("T1", 0)], capsys, monkeypatch)


def test_what_nursing_studies_ask_is_told_of_the_mitt_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    values = [{"effective@1": 1.0, "comfortable@1": 0.0}, {"effective@1": 0.0, "comfortable@1": 1.0}]
    scores = [make_score("T3", seed, additional=found) for seed, found in enumerate(values)]
    scores.append(make_score("T1", 0, additional={"effective@1": 0.0, "comfortable@1": 1.0}))
    mitt = [score.model_copy(update={"overrides": {"scene.tool": "mitt"}}) for score in scores]
    told = shown(mitt, capsys, monkeypatch)
    assert "Wiped clean (effective@1): 1 of 2" in told, "of scrub tasks"
    assert "Wiped below 25 mmHg (comfortable@1): 2 of 3" in told
    assert "effective@1" not in shown(scores, capsys, monkeypatch)
