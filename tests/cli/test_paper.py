"""``carecontact paper`` over the recordings that are kept for tests."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from carecontact.cli import main, paper
from carecontact.protocols import load_protocol
from carecontact.runs import score_run, write_scores
from carecontact.runs.run_scores import RunScores
from tests.reports.synthetic_run import make_score

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    for name in ("T1-s000.h5", "T2-s000.h5"):
        shutil.copy(GOLDEN / name, tmp_path / "run" / name)
    write_scores(tmp_path / "run", score_run(tmp_path / "run"))
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_builds_are_the_same_bytes(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "run", "--out", "one"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert main(["paper", "run", "--out", "two"]) == 0
    one = contents(run / "one")
    assert one == contents(run / "two")
    assert sorted(told) == sorted(f"one/{name}" for name in one)
    assert {name for name in one if name.startswith("figures")} == {
        f"figures/{name}.{ending}"
        for name in ("overview", "traces", "force-indentation", "outcomes")
        for ending in ("svg", "pdf")
    }
    assert all(b"Date" not in content for name, content in one.items() if name.endswith(("svg", "pdf")))


def test_results_alone_give_what_needs_no_recording(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.move(run / "run" / "results.json", run / "alone.json")
    assert main(["paper", "alone.json", "--out", "p"]) == 0
    told = capsys.readouterr().out
    assert "the figures of traces and of force and indentation are left out" in told
    assert "the tables of tasks and protocol are left out" in told, "no recording, and an earlier protocol"
    assert {path.stem for path in (run / "p" / "figures").iterdir()} == {"overview", "outcomes"}
    assert main(["paper", "alone.json", "--out", "q", "--no-figures"]) == 0
    assert not (run / "q" / "figures").exists()


def test_mistakes_are_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "nowhere", "--out", "p"]) == 2
    assert main(["paper", "run", "--out", "run/results.json"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("error: nowhere: no such folder")
    assert told[1] == "error: --out run/results.json: this is a file; name a folder"


def test_results_alone_of_one_level_have_its_protocol() -> None:
    protocol = load_protocol("bathing-wide-v1", level="L2")
    score = make_score("T1", 0).model_copy(update={"protocol_id": protocol.name, "protocol_sha256": protocol.sha256})
    assert paper._protocol([], [RunScores(scores=[score])]) == protocol  # pyright: ignore[reportPrivateUsage]
