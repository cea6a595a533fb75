from __future__ import annotations

import json
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.validation import energy, sensitivity, stability
from carecontact.validation.result import CheckResult, Measure


def verdict(value: float) -> CheckResult:
    return CheckResult(
        check="energy", title=energy.TITLE, measures=(Measure(name="made up", value=value, unit="J", limit=1.0),)
    )


@pytest.mark.parametrize(
    ("value", "status", "word"), [(0.5, 0, "passed"), (1.5, 1, "FAILED"), (float("nan"), 1, "FAILED")]
)
def test_exit_status_and_record_follow_the_verdict(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    value: float, status: int, word: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(energy, "run", lambda subject, *, quick: verdict(value))
    monkeypatch.setattr(energy, "draw", lambda result, figure: figure.subplots())
    arguments = ["validate", "--quick", "--checks", "energy", "--out", str(tmp_path / "out")]
    assert main(arguments) == status
    told = capsys.readouterr().out
    assert word in told
    assert ("made up" in told) is (status == 1)
    record = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert record["passed"] is (status == 0)
    assert record["quick"] is True
    assert (tmp_path / "out" / "energy.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [(["--checks", "energie"], "force-balance"), (["--checks", "energy,energy"], "each once"),
     (["--body", "nobody"], "man-adult"), (["--protocol", "nothing"], "bathing-v3-draft"),
     (["--fem"], "--fem runs no check")],
)  # fmt: skip
def test_a_wrong_name_is_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], told: str
) -> None:
    assert main(["validate", "--quick", "--out", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert "Traceback" not in error
    assert not list(tmp_path.iterdir())


def test_misses_that_do_not_decide_are_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    shown = tuple(Measure(name=f"shown {v}", value=v, limit=1.0, decides=False) for v in (0.5, 1.5, 2.5))
    found = verdict(0.5)
    found = CheckResult(check="energy", title=found.title, measures=found.measures + shown)
    monkeypatch.setattr(energy, "run", lambda subject, *, quick: found)
    monkeypatch.setattr(energy, "draw", lambda result, figure: figure.subplots())
    assert main(["validate", "--quick", "--checks", "energy", "--out", str(tmp_path / "out")]) == 0
    assert "1 of 1 limits met; 2 of 3 that do not decide missed" in capsys.readouterr().out


def test_the_last_line_says_how_many_of_the_checks_that_ran_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for module, value in ((energy, 0.5), (stability, 1.5), (sensitivity, 0.5)):
        monkeypatch.setattr(module, "run", lambda subject, *, quick, value=value: verdict(value))
        monkeypatch.setattr(module, "draw", lambda result, figure: figure.subplots())
    arguments = ["validate", "--quick", "--out", str(tmp_path / "out"), "--checks"]
    assert main([*arguments, "energy,stability,sensitivity"]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("FAILED: 1 of the 3 checks that ran (of 13); ")
    assert main([*arguments, "energy,sensitivity"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("passed: the 2 checks that ran (of 13); ")
