from __future__ import annotations

import json
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.validation import probes
from carecontact.validation.result import CheckResult, Measure


@pytest.mark.parametrize(("steps", "status", "word"), [(4.0, 0, "pass"), (3.0, 1, "FAIL")])
def test_exit_status_and_record_follow_the_verdict(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    steps: float, status: int, word: str,
) -> None:  # fmt: skip
    import numpy as np

    def made_up(subject: object, probe: probes.Probe) -> CheckResult:
        line = Measure(name="steps", value=steps, limit=4.0, side="at least")
        curve = np.stack([np.array(probe.levels), np.arange(len(probe.levels), dtype=float)])
        return CheckResult(check=probe.metric, title="made up", measures=(line,), curves={"scores": curve})

    monkeypatch.setattr(probes, "run", made_up)
    assert main(["probe", "--metrics", "C1@1,C5@1", "--out", str(tmp_path / "out")]) == status
    assert f"{word}  C1@1  made up" in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "probe.json").read_text())
    assert record["passed"] is (status == 0)
    assert [row["check"] for row in record["probes"]] == ["C1@1", "C5@1"]
    assert (tmp_path / "out" / "probe.png").is_file()


@pytest.mark.parametrize("metrics", ["C3@1", "C1@1,C1@1", "", "C1,C1@1"])
def test_a_wrong_metric_is_one_line(metrics: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["probe", "--metrics", metrics, "--out", str(tmp_path / "out")]) == 2
    assert "valid: C1@1, C2@1, C4@1, C5@1" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
