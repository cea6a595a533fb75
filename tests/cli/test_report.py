"""``carecontact report`` of a run with the pages of its trials, and of one recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.recording import write_recording
from tests.reports.synthetic_trial import whole_trial


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Path:
    """A scored run of two trials, in the folder ``run`` of the current one."""
    monkeypatch.chdir(tmp_path)
    Path("run").mkdir()
    write_recording(whole_trial(), Path("run/T1-s000.h5"))
    write_recording(whole_trial("T2", touched=False), Path("run/T2-s000.h5"))
    assert main(["score", "run"]) == 0
    capsys.readouterr()
    return Path("run")


def test_the_page_of_one_trial(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "run/T1-s000.h5"]) == 0
    assert capsys.readouterr().out == "page of the trial: run/trial/T1-s000.html\n"
    assert "T1 Touch forearm, seed 0, passed" in (run / "trial/T1-s000.html").read_text()
    assert not (run / "report.html").exists()
    assert [path.name for path in (run / "trial").iterdir()] == ["T1-s000.html"]


def test_the_report_links_the_pages_that_are_there(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "run"]) == 0
    assert 'href="trial/' not in (run / "report.html").read_text()
    assert main(["report", "run", "--trials"]) == 0
    assert f"pages of 2 trials: {Path('run/trial')}" in capsys.readouterr().out
    text = (run / "report.html").read_text()
    for trial_id in ("T1-s000", "T2-s000"):
        assert f'href="trial/{trial_id}.html"' in text
        assert f'href="{trial_id}.h5"' in text
        assert f'href="../report.html#{trial_id}"' not in text
        assert (run / f"trial/{trial_id}.html").is_file()


def test_a_trial_that_cannot_be_drawn_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = whole_trial("T2", touched=False)
    broken.arrays["report/skin_faces"][0, 0] = 10_000
    write_recording(broken, run / "T2-s000.h5")
    assert main(["score", "run"]) == 0
    assert main(["report", "run", "--trials"]) == 0
    told = capsys.readouterr().out
    assert "no page of T2-s000: T2-s000: report/skin_faces does not fit report/skin_in_world" in told
    assert f"pages of 1 trial: {Path('run/trial')}" in told


@pytest.mark.parametrize("option", [["--trials"], ["--baseline", "other"]])
def test_options_of_a_run_are_refused_for_a_trial(
    run: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "run/T1-s000.h5", *option]) == 2
    assert f"{option[0]} belongs to the report of a run: name its folder, run" in capsys.readouterr().err


def test_a_file_that_is_no_recording_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "run/results.json"]) == 2
    assert "run/results.json" in capsys.readouterr().err


def test_a_file_that_is_no_recording_is_told_what_report_takes(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "results.json.gz").write_bytes(b"")
    assert main(["report", "run/results.json.gz"]) == 2
    told = "report takes the folder of a run, or one recording in it (TRIAL.h5); name run"
    assert f"run/results.json.gz: {told}" in capsys.readouterr().err
