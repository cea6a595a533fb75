"""run, score and demo over workers that only write recordings."""

from __future__ import annotations

import functools
import json
import sys
from pathlib import Path

import pytest

import carecontact
import carecontact.cli.run as cli_run
from carecontact.cli import main
from carecontact.cli.demo import missing_successes
from carecontact.cli.score import differences
from carecontact.scoring import score_run
from carecontact.trials.supervisor import run_trials

FAKE = (sys.executable, str(Path(__file__).parents[1] / "trials" / "fake_worker.py"))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    monkeypatch.setattr(cli_run, "run_trials", functools.partial(run_trials, worker_command=FAKE))
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", "{}")
    monkeypatch.setenv("PYTHONPATH", str(Path(carecontact.__file__).parents[1]))
    monkeypatch.chdir(tmp_path)
    return monkeypatch


def test_run_scores_reports_and_goes_on(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0", "--out", "r", "--jobs", "2"]
    fake.setenv("FAKE_PLAN", json.dumps({"T2-s000": "exit"}))
    assert main(command) == 1
    told = capsys.readouterr().out
    assert "T2-s000 harness_error" in told
    assert "1 trial(s) failed in the harness; see r/T2-s000.log" in told
    assert "--retry-failed" in told
    assert {t["trial_id"] for t in json.loads(Path("r/results.json").read_text())["trials"]} == {"T1-s000", "T2-s000"}
    assert Path("r/report.html").stat().st_size > 1000

    fake.setenv("FAKE_PLAN", "{}")
    assert main(command) == 1
    assert "nothing differs" in capsys.readouterr().out
    assert main([*command, "--retry-failed"]) == 0
    assert Path("ran.txt").read_text().split()[::2].count("T1-s000") == 1


def test_a_policys_failure_is_a_result(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy"}))
    assert main(["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r"]) == 0
    assert "1 trial(s) failed in the policy's process" in capsys.readouterr().out


def test_score_says_what_differs_and_names_what_it_skips(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0-1", "--out", "r"])
    original = Path("r/results.json").read_bytes()
    doctored = json.loads(original)
    doctored["trials"][0]["stroke_m"] = 9.5
    Path("r/results.json").write_text(json.dumps(doctored))
    capsys.readouterr()
    assert main(["score", "r"]) == 0
    told = capsys.readouterr().out
    assert "1 value(s) differ" in told
    assert "trials.T1-s000.stroke_m: 9.5 -> 0.0" in told
    assert Path("r/results.json").read_bytes() == original

    Path("r/T1-s001.h5").write_bytes(b"broken")
    assert main(["score", "r"]) == 0
    assert "skipped T1-s001.h5" in capsys.readouterr().out


def test_demo_without_contact_fails_and_replaces_only_its_own_files(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path("runs/demo")
    folder.mkdir(parents=True)
    (folder / "T9-s000.h5").write_bytes(b"old")
    (folder / "notes.txt").write_text("mine")
    fake.setenv("FAKE_PLAN", json.dumps({"T2-s000": "policy", "T3-s000": "kill"}))
    assert main(["demo"]) == 1
    told = capsys.readouterr().out
    assert "demo: T2-s000 ended as process_failure: gone" in told
    assert "demo: T3-s000 ended as harness_error: the trial's process died of signal 9" in told
    assert all(f"demo: no {action} succeeded" in told for action in ("touch", "push", "scrub"))
    assert "demo failed in" in told
    assert not (folder / "T9-s000.h5").exists()
    assert (folder / "notes.txt").read_text() == "mine"
    assert len(list(folder.glob("*.h5"))) == 7

    scores = score_run(folder).scores
    won = [s.model_copy(update={"c3_success": s.task_id in ("T1", "T2", "T7")}) for s in scores]
    assert missing_successes(won) == []
    assert missing_successes([s for s in won if s.task_id != "T2"]) == ["no push succeeded"]


def test_differences_match_trials_by_id() -> None:
    before = {"trials": [{"trial_id": "b", "x": 1}]}
    after = {"trials": [{"trial_id": "a", "x": 5}, {"trial_id": "b", "x": 1}]}
    assert differences(None, after) == []
    assert differences(before, before) == ["nothing differs from the results.json that was there"]
    lines = differences(before, after)
    assert lines[0].startswith("1 value(s) differ")
    assert lines[1].startswith("  trials.a: null -> ")
