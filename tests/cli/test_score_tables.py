"""What the terminal shows of scores, at 80 columns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.cli.score_tables import print_table
from carecontact.contract.protocol import Protocol
from carecontact.recording import Recording, write_recording
from carecontact.runs.run_scores import RunScores
from tests.reports.synthetic_run import FAILED, NO_CONTACT, PROTOCOL, Run, fill, make_score

CRASHED = NO_CONTACT | {"ended": "process_failure", "failure_mode": "process_failure"}
PRESSED = FAILED | {
    "ended": "process_failure", "failure_mode": "process_failure", "over_limit": {"right_forearm": 61.9 / 35},
    "peak_force_n": {"right_forearm": 61.9},
}  # fmt: skip


def with_mitt(protocol: Protocol) -> Protocol:
    """The same protocol, with the mitt on the robot's hand; no command is said to have put it there."""
    return protocol.model_copy(update={"scene": protocol.scene.model_copy(update={"tool": "mitt"})})


def shown(
    scores: list, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, protocol: Protocol = PROTOCOL
) -> str:
    monkeypatch.setenv("COLUMNS", "80")
    print_table(RunScores(scores=scores), protocol)
    return capsys.readouterr().out


def test_seven_tasks_fit_80_columns_and_no_name_is_cut(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run()
    fill(run, 0)
    scores = [s.model_copy(update={"additional": {"beyond_calibrated@2": 0.125}}) for s in run.scores]
    told = shown(scores, capsys, monkeypatch)
    assert [line for line in told.splitlines() if len(line) > 80] == []
    assert "…" not in told
    assert "beyond_calibrated@2" in told
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
    values = [{"effective@1": 1.0, "comfortable@2": 0.0}, {"effective@1": 0.0, "comfortable@2": 1.0}]
    scores = [make_score("T3", seed, additional=found) for seed, found in enumerate(values)]
    scores.append(make_score("T1", 0, additional={"effective@1": 0.0, "comfortable@2": 1.0}))
    told = shown(scores, capsys, monkeypatch, with_mitt(PROTOCOL))
    assert "Wiped clean (effective@1): 1 of 2" in told, "of scrub tasks"
    assert "Wiped below 25 mmHg (comfortable@2): 2 of 3" in told
    assert "effective@1" not in shown(scores, capsys, monkeypatch)


def test_terminal_and_page_know_the_mitt_of_a_protocol_that_no_command_changed(
    pressed: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = {}
    for name, change in (("caps", lambda protocol: protocol), ("mitt", with_mitt)):
        spec = pressed.header.spec
        header = pressed.header.model_copy(update={"spec": spec.model_copy(update={"protocol": change(spec.protocol)})})
        (folder := tmp_path / name).mkdir()
        write_recording(replace(pressed, header=header), folder / "T1-s000.h5")
        assert main(["score", str(folder)]) == 0
        told = capsys.readouterr().out
        assert main(["report", str(folder)]) == 0
        page = (folder / "report.html").read_text()
        found[name] = ["Wiped below 25 mmHg (" in told, "trials that pass, of those with a value" in page]
    assert found == {"caps": [False, False], "mitt": [True, True]}
