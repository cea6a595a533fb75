from __future__ import annotations

from pathlib import Path

import pytest
from tools.keep_sweep import TABLE_BEGINS, TABLE_ENDS, main

from carecontact.reports.compare.kept import beside_kept
from carecontact.runs.results_file import write_scores
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores
from carecontact.scoring import TrialScore
from tests.reports.synthetic_run import make_score

LEVEL = "bathing-wide-v2-draft L2"


def cell(sweep: Path, name: str, policy: str, passed: int, *, seeds: int = 2, **changes: object) -> RunScores:
    scores: list[TrialScore] = []
    for seed in range(seeds):
        score = make_score("T1", seed)
        scores.append(
            score.model_copy(update={"protocol_id": LEVEL, "policy": policy, "safety_gated": seed < passed, **changes})
        )
    run = RunScores(scores=scores)
    (sweep / "cells" / name).mkdir(parents=True)
    write_scores(sweep / "cells" / name, run)
    return run


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    folder = tmp_path / "sweep"
    cell(folder, "a", "mean-person", 1, policy_arguments={"person": "worse"})
    cell(folder, "b", "mean-person", 2, policy_arguments={"person": "better"})
    cell(folder, "c", "state-machine", 2)
    return folder


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "README.md").write_text(f"# Results\n\n{TABLE_BEGINS}old\n{TABLE_ENDS}\nThe end.\n")
    return tmp_path / "kept"


def test_what_is_kept_stands_beside_a_run_of_the_level(
    sweep: Path, kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        assert main([str(sweep), "--out", str(kept)]) == 0
        assert "3 files of scores" in capsys.readouterr().out
        assert (kept / "README.md").read_text() == (
            f"# Results\n\n{TABLE_BEGINS}| policy | {LEVEL} |\n|---|---|\n"
            "| `mean-person` person=better | 2 (100 %) |\n| `state-machine` | 2 (100 %) |\n"
            f"| `mean-person` person=worse | 1 (50 %) |\n{TABLE_ENDS}\nThe end.\n"
        )
    folder = kept / "bathing-wide-v2-draft-L2"
    assert {file.name for file in folder.iterdir()} == {
        "mean-person.json.gz", "mean-person-person-worse.json.gz", "state-machine.json.gz",
    }  # fmt: skip
    best = read_scores(folder / "mean-person.json.gz")
    assert best.scores[0].policy_title == "mean-person person=better"
    beside, _ = beside_kept(read_scores(folder / "state-machine.json.gz"), [], folders=[kept])
    assert beside is not None
    assert list(beside.kept) == ["mean-person person=better"]


def test_unequal_cells_are_refused(sweep: Path, kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell(sweep, "d", "hover", 0, seeds=3)
    assert main([str(sweep), "--out", str(kept)]) == 2
    assert "different trials" in capsys.readouterr().err
    assert main([str(kept), "--out", str(kept)]) == 2
    assert "no cells" in capsys.readouterr().err


def test_a_page_without_a_place_for_the_table_stays_as_it_is(
    sweep: Path, kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (kept / "README.md").write_text("# Results\n")
    assert main([str(sweep), "--out", str(kept)]) == 2
    assert "no place for the table" in capsys.readouterr().err
    assert (kept / "README.md").read_text() == "# Results\n"


def test_a_run_without_arguments_does_not_replace_a_better_one_with_some(sweep: Path, kept: Path) -> None:
    cell(sweep, "d", "mean-person", 0)
    main([str(sweep), "--out", str(kept)])
    folder = kept / "bathing-wide-v2-draft-L2"
    assert read_scores(folder / "mean-person.json.gz").scores[0].policy_title == "mean-person person=better"
    assert read_scores(folder / "mean-person-default.json.gz").scores[0].policy_title == "mean-person"
