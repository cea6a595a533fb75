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
    text = (run / "run" / "results.json").read_text()
    (run / "alone.json").write_text(text.replace(load_protocol().sha256, "0" * 64))
    assert main(["paper", "alone.json", "--out", "p"]) == 0
    told = capsys.readouterr().out
    assert "the figures of traces and of force and indentation are left out" in told
    assert "the tables of tasks and protocol are left out" in told, "no recording, and an unknown protocol"
    assert {path.stem for path in (run / "p" / "figures").iterdir()} == {"overview", "outcomes"}
    assert main(["paper", "alone.json", "--out", "q", "--no-figures"]) == 0
    assert not (run / "q" / "figures").exists()


def test_tables_and_figures_of_an_earlier_command_do_not_stay(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "run", "--out", "p"]) == 0
    mine = run / "p" / "figures" / "mine.svg"
    mine.touch()
    capsys.readouterr()
    assert main(["paper", "run", "--out", "p", "--no-figures"]) == 0
    assert "removed p/figures/traces.svg, which an earlier command had written" in capsys.readouterr().out
    assert list((run / "p" / "figures").iterdir()) == [mine]


def test_a_command_names_only_options_that_it_has(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "run" / "results.json").unlink()
    assert main(["paper", "run", "--out", "p"]) == 2
    told = capsys.readouterr().err
    assert "run `carecontact score run`" in told
    assert "--rescore" not in told


@pytest.mark.parametrize("again", ["run", "./run", "run/results.json"])
def test_a_run_is_not_tested_against_itself(run: Path, again: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "run", again, "--out", "p"]) == 2
    assert "is given twice; name different runs" in capsys.readouterr().err
    assert not (run / "p").exists()


def test_a_recording_is_no_run(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["paper", "run/T1-s000.h5"], ["compare", "run/T1-s000.h5", "run"]):
        assert main(command) == 2
        told = capsys.readouterr().err
        assert "run/T1-s000.h5: this is the recording of one trial; name the folder of a run" in told
        assert told.count("\n") == 1


def test_mistakes_are_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "nowhere", "--out", "p"]) == 2
    assert main(["paper", "run", "--out", "run/results.json"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("error: nowhere: no such folder")
    assert told[1] == "error: --out run/results.json: this is a file; name a folder"


def test_results_alone_of_one_level_have_its_protocol() -> None:
    protocol = load_protocol("bathing-wide-v2-draft", level="L2")
    score = make_score("T1", 0).model_copy(update={"protocol_id": protocol.name, "protocol_sha256": protocol.sha256})
    assert paper._protocol([], [RunScores(scores=[score])]) == protocol  # pyright: ignore[reportPrivateUsage]
