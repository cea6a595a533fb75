from __future__ import annotations

from pathlib import Path

import pytest
from tools.keep_sweep import main

from carecontact.reports.compare.kept import beside_kept
from carecontact.runs.results_file import write_scores
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores
from carecontact.scoring import TrialScore
from tests.reports.synthetic_run import make_score

LEVEL = "bathing-wide-v1 L2"


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


CELLS = "| policy | trials | folder |\n| --- | --- | --- |\n| a | 2 | `cells/a_1` |\n| b\\|c | 1 | `cells/b_2` |\n"


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    folder = tmp_path / "sweep"
    cell(folder, "a", "mean-person", 1, policy_arguments={"person": "worse"})
    cell(folder, "b", "mean-person", 2, policy_arguments={"person": "better"})
    cell(folder, "c", "state-machine", 2)
    (folder / "sweep.md").write_text(
        "# Sweep results\n\n3 cells of 3 policies.\n\n## Cells\n\n" + CELLS + "\n## Provenance\n\n| plan | x |\n"
    )
    return folder


def test_what_is_kept_stands_beside_a_run_of_the_level(
    sweep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "kept"
    assert main([str(sweep), "--out", str(kept)]) == 0
    assert "3 files of scores" in capsys.readouterr().out
    page = (kept / "bathing-wide-v1.md").read_text()
    assert page.startswith("# bathing-wide-v1: results\n\nSeeds 0 to 1, 2 trials")
    assert "3 cells of 3 policies.\n" in page
    assert page.endswith("| a | 2 |\n| b\\|c | 1 |\n\n## Provenance\n\n| plan | x |\n"), (
        "folders are not beside the page"
    )
    assert "# Sweep" not in page
    folder = kept / "bathing-wide-v1-L2"
    assert {file.name for file in folder.iterdir()} == {
        "mean-person.json.gz", "mean-person-person-worse.json.gz", "state-machine.json.gz",
    }  # fmt: skip
    best = read_scores(folder / "mean-person.json.gz")
    assert best.scores[0].policy_title == "mean-person person=better"
    beside, _ = beside_kept(read_scores(folder / "state-machine.json.gz"), [], folders=[kept])
    assert beside is not None
    assert list(beside.kept) == ["mean-person person=better"]


def test_unequal_cells_are_refused(sweep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell(sweep, "d", "hover", 0, seeds=3)
    assert main([str(sweep), "--out", str(tmp_path / "kept")]) == 2
    assert "same trials in each" in capsys.readouterr().err
    assert main([str(tmp_path), "--out", str(tmp_path / "kept")]) == 2
    assert "no cells" in capsys.readouterr().err


def test_a_changed_protocol_has_a_page_of_its_own_and_stands_beside_no_run(sweep: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    for name in ("a", "b", "c"):
        (sweep / "cells" / name).rename(sweep / "cells" / f"{name}_200_abcd")
    assert main([str(sweep), "--changed", "stiffness", "--out", str(kept)]) == 0
    page = (kept / "bathing-wide-v1-stiffness.md").read_text()
    assert page.startswith("# bathing-wide-v1: sweep of stiffness\n\nSeeds 0 to 1, 2 trials in each cell.")
    assert "examples/cluster/stiffness.toml" in page
    folder = kept / "sensitivity" / "bathing-wide-v1-stiffness"
    assert [file.name for file in sorted(folder.iterdir())] == ["a_200.json.gz", "b_200.json.gz", "c_200.json.gz"]
    beside, _ = beside_kept(read_scores(folder / "c_200.json.gz"), [], folders=[kept])
    assert beside is None


def test_the_scores_alone_make_no_page(sweep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a_1", "b_2", "c_3"):
        (sweep / "cells" / name[0]).rename(sweep / "cells" / name)
    kept = tmp_path / "kept"
    assert main([str(sweep), "--out", str(kept), "--scores-only", "people"]) == 0
    assert capsys.readouterr().out == "3 files of scores\n"
    files = {str(file.relative_to(kept)) for file in kept.rglob("*") if file.is_file()}
    assert files == {f"sensitivity/people-{name}.json.gz" for name in "abc"}
    assert [score.safety_gated for score in read_scores(kept / "sensitivity" / "people-a.json.gz").scores] == [
        True,
        False,
    ]
