from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tools.keep_sweep import TABLE_BEGINS, TABLE_ENDS, main
from tools.net import ROOT
from tools.net import main as net_main

from carecontact.pictures import decoded
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.recording import Recording, write_recording
from carecontact.report.baselines import beside_shipped_scores
from carecontact.runs.pooling import RunScores
from carecontact.runs.results_file import write_scores
from carecontact.runs.scoring import read_scores
from carecontact.scoring import TrialScore
from tests.report.synthetic import make_score
from tests.scoring.synthetic import touch
from tools import gallery, gate_stability, size, strength


def test_a_column_for_each_seed_and_a_row_of_arms(tmp_path: Path) -> None:
    out = tmp_path / "new" / "people.png"
    gallery.main(["--protocol", "bathing-v3", "--seeds", "3,18", "--out", str(out)])
    picture = decoded(out.read_bytes())
    row = gallery.LABEL + gallery.HEIGHT
    assert picture.shape == (2 * row, 2 * gallery.WIDTH, 3)
    tiles = picture.reshape(2, row, 2, gallery.WIDTH, 3).swapaxes(1, 2)[:, :, gallery.LABEL :]
    # The arm lies elsewhere in both views, and the empty floor at the right of the overhead picture is cut off.
    assert (np.abs(np.diff(tiles.astype(int), axis=1)).max(-1) > 40).mean((1, 2, 3)).min() > 0.01
    sheet = (tiles[0, :, :, gallery.WIDTH * 2 // 3 :] > 220).all(-1).mean((1, 2))
    assert sheet.min() > 0.3


LEVEL = "bathing-wide-v2 L2"


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


@pytest.mark.parametrize("field", gate_stability.FIELDS)
def test_each_gate_that_is_varied_is_one_of_the_exam(field: str) -> None:
    exam = load_protocol("bathing-wide-v2", level="L2")
    low, high = (overridden(exam, {f"gates.{field}": value}) for value in gate_stability.FIELDS[field])
    assert len({exam.sha256, low.sha256, high.sha256}) == 3


LEVELS, COUNTED = ("L2", "L3"), ("touches of 2", "pushes of 0", "scrubs of 0", "harmless")


def test_what_is_kept_stands_beside_a_run_of_the_level(
    sweep: Path, kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        assert main([str(sweep), "--out", str(kept)]) == 0
        assert "3 files of scores" in capsys.readouterr().out
        assert (kept / "README.md").read_text() == (
            f"# Results\n\n{TABLE_BEGINS}| policy | {LEVEL} |\n|---|---|\n"
            "| `mean-person` person=better | 2 (100 %) |\n| `state-machine` | 2 (100 %) |\n"
            "| `mean-person` person=worse | 1 (50 %) |\n\n"
            f"| policy |{''.join(f' {level}: {title} |' for level in LEVELS for title in COUNTED)}\n{'|---' * 9}|\n"
            f"| `mean-person` person=better | 2 | 0 | 0 | 0 of 0 |{' not run |' * 4}\n"
            f"| `state-machine` | 2 | 0 | 0 | 0 of 0 |{' not run |' * 4}\n"
            f"| `mean-person` person=worse | 1 | 0 | 0 | 0 of 0 |{' not run |' * 4}\n{TABLE_ENDS}\nThe end.\n"
        )
    folder = kept / "bathing-wide-v2-L2"
    assert {file.name for file in folder.iterdir()} == {
        "mean-person.json.gz", "mean-person-person-worse.json.gz", "state-machine.json.gz",
    }  # fmt: skip
    best = read_scores(folder / "mean-person.json.gz")
    assert best.scores[0].policy_title == "mean-person person=better"
    beside, _ = beside_shipped_scores(read_scores(folder / "state-machine.json.gz"), [], folders=[kept])
    assert beside is not None
    assert list(beside.kept) == ["mean-person person=better"]


def test_pieces_of_a_plan_are_kept_one_after_another(sweep: Path, kept: Path, tmp_path: Path) -> None:
    main([str(sweep), "--out", str(kept)])
    later = tmp_path / "later"
    cell(later, "a", "hover", 0)
    cell(later, "b", "hover", 1, protocol_id="bathing-wide-v2 L3", seeds=3)
    assert main([str(later), "--out", str(kept)]) == 0
    page = (kept / "README.md").read_text()
    assert f"| policy | {LEVEL} | bathing-wide-v2 L3 |\n" in page
    assert "| `state-machine` | 2 (100 %) | not run |\n" in page
    assert "| `hover` | 0 (0 %) | 1 (33 %) |\n" in page


def test_unequal_cells_are_refused(sweep: Path, kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main([str(sweep), "--out", str(kept)])
    page = (kept / "README.md").read_text()
    cell(sweep, "d", "hover", 0, seeds=3)
    assert main([str(sweep), "--out", str(kept)]) == 2
    assert "different trials; run the rest, or remove the older one" in capsys.readouterr().err
    assert (kept / "README.md").read_text() == page
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
    folder = kept / "bathing-wide-v2-L2"
    assert read_scores(folder / "mean-person.json.gz").scores[0].policy_title == "mean-person person=better"
    assert read_scores(folder / "mean-person-default.json.gz").scores[0].policy_title == "mean-person"


# The net finds what differs between two runs, and two runs of one revision are equal bit for bit.

FORCE, WALL = "scorer/force_human_from_robot_in_world", "wall/seconds"


def stored(folder: Path, *, seed: int = 0, score: float = 1.0, **arrays: np.ndarray) -> str:
    folder.mkdir()
    recording = touch(seed=0)
    spec = recording.header.spec.model_copy(update={"seed": seed})
    changed = replace(recording, header=recording.header.model_copy(update={"spec": spec}))
    timed = {**changed.arrays, WALL: np.array([float(len(str(folder)))]), **arrays}
    write_recording(Recording(header=changed.header, arrays=timed), folder / "T1-s000.h5")
    (folder / "results.json").write_text(json.dumps({"trials": [{"c1": score}]}))
    return str(folder)


def test_equal_runs_are_equal_whatever_time_they_took(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert net_main(["--runs", stored(tmp_path / "a"), stored(tmp_path / "another")]) == 0
    assert capsys.readouterr().out == "0 differences that are not allowed, and 0 that are\n"


def test_each_difference_is_named_by_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    force = touch(seed=0).arrays[FORCE].copy()
    force[-1, 0, 0] += np.float32(2**-20)
    runs = ["--runs", stored(tmp_path / "a"), stored(tmp_path / "b", seed=1, score=2.0, **{FORCE: force})]
    assert net_main(runs) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "results/trials/0/c1: 1.0 != 2.0"
    assert "T1-s000/header/spec/seed: 0 != 1" in lines
    assert f"T1-s000/{FORCE}: 1 of {force.size} numbers differ" in lines
    assert net_main([*runs, "--allow", "results/*", "--allow", "T1-s000/header/*"]) == 1
    assert capsys.readouterr().out.splitlines()[1:] == ["1 differences that are not allowed, and 2 that are"]


def test_a_trial_that_one_run_lacks_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [stored(tmp_path / "a"), stored(tmp_path / "b")]
    (tmp_path / "b" / "T1-s000.h5").unlink()
    assert net_main(["--runs", *runs]) == 1
    assert capsys.readouterr().out.startswith(f"T1-s000: only in {tmp_path / 'a'}\n")


@pytest.mark.slow
def test_two_runs_of_this_revision_are_equal_bit_for_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert net_main([str(ROOT), "--short", "--out", str(tmp_path)]) == 0, capsys.readouterr().out
    assert len(list(tmp_path.glob("*/*/*.h5"))) == 6


# The results in docs/ are what the scores kept beside them say.

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
KEPT = sorted(RESULTS.glob("*/*.json.gz"))
PAGE = (RESULTS / "README.md").read_text()


@pytest.mark.parametrize("scores", KEPT, ids=lambda path: f"{path.parent.name} {path.name}")
def test_every_kept_run_is_whole_and_of_the_shipped_protocol(scores: Path) -> None:
    run = read_scores(scores)
    name, _, level = run.scores[0].protocol_id.partition(" ")
    protocol = load_protocol(name, level=level or None)
    assert scores.parent.name == protocol.title.replace(" ", "-")
    assert {score.protocol_sha256 for score in run.scores} == {protocol.sha256}
    assert not any(score.ended == "harness_error" for score in run.scores), "a void trial says nothing"
    seeds = {score.seed for score in run.scores}
    assert {(s.task_id, s.seed) for s in run.scores} == {(task.id, seed) for task in protocol.tasks for seed in seeds}


@pytest.mark.parametrize("scores", KEPT, ids=lambda path: f"{path.parent.name} {path.name}")
def test_the_page_has_the_rate_of_every_kept_run(scores: Path) -> None:
    """In a row that begins with the policy's name in backticks, as ``12 (19 %)``."""
    run = read_scores(scores)
    passed, policy = sum(score.safety_gated for score in run.scores), run.scores[0].policy
    rows = re.findall(rf"^\| `{re.escape(policy)}`.*$", PAGE, re.MULTILINE)
    assert any(f"| {passed} ({100 * passed / len(run.scores):.0f} %) |" in row for row in rows)


# The tools that measure the suite: a fault that is planted is seen or not, and sizes are counted.

CODE = """\
def half(n):
    \"\"\"Whole halves.\"\"\"
    if n < 0:
        raise ValueError(
            "negative")

    return n // 2
"""
TEST = """\
from carecontact.code import half
def test_half():
    assert half(5) == 2
"""


FAULTS = tomllib.loads((strength.ROOT / "tests" / "strength.toml").read_text())["fault"]


def test_every_recorded_fault_can_still_be_planted() -> None:
    """A change that moves or rewrites such a place brings its entry along."""
    stale = {
        fault["id"]: found for fault in FAULTS if isinstance(found := strength.find(strength.ROOT, fault["code"]), str)
    }
    assert stale == {}
    assert [fault["id"] for fault in FAULTS if not (strength.ROOT / fault["tests"]).exists()] == []


@pytest.mark.slow
def test_faults_are_planted_one_after_another_and_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in (("src/carecontact/__init__.py", ""), ("src/carecontact/code.py", CODE)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    for name in ("runs/test_code.py", "runs/test_other.py"):
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / name).write_text(TEST if "code" in name else "def test_nothing(): pass\n")
    monkeypatch.setattr(strength, "ROOT", tmp_path)
    monkeypatch.setattr(strength, "LEAST_S", 1)
    whole, other = "tests/runs/test_code.py", "tests/runs/test_other.py"
    faults = [
        ("killed", "return n // 2", "return n / 2", whole),
        ("hung", "return n // 2", "while True:\n    pass", whole),
        ("killed", "return n // 2", "return None", other),
        ("killed", "return n // 2", "return None", "tests/runs/test_gone.py"),
        ("survived", 'if n < 0:\nraise ValueError(\n"negative")', "if n < -1:\n    raise ValueError", whole),
        ("stale", "return n // 3", "return n", whole),
        ("stale", "return n // 2", "return n", "tests/gone/test_gone.py"),
    ]
    entries = [
        {"id": str(number), "code": code, "broken": bad, "tests": tests}
        for number, (_, code, bad, tests) in enumerate(faults)
    ]
    found = strength.measure(entries, jobs=2, quick=False)
    assert [found[entry["id"]].state for entry in entries] == [state for state, *_ in faults]
    assert found["0"].by == "tests/runs/test_code.py::test_half"


def test_mutants_change_one_thing_each() -> None:
    found = {CODE[:first] + new + CODE[last:] for _, first, last, new in strength.candidates(CODE)}
    changes = [("n < 0", "n <= 0"), ("< 0", "< 1"), ("n // 2", "n * 2"), ("n // 2", "n // 3"), ("n // 2", "None")]
    dropped = CODE.replace('raise ValueError(\n            "negative")', "pass")
    assert found == {CODE.replace(*change) for change in changes} | {dropped}


def test_size_counts_statements_and_not_line_breaks(tmp_path: Path) -> None:
    (tmp_path / "code.py").write_text(CODE)
    assert size.size(tmp_path) == (1, 7, 5)
