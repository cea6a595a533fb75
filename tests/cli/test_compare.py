"""``carecontact compare`` and ``report`` over results.json, alone and beside its recordings."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from carecontact.cli import main
from carecontact.errors import ConfigError
from carecontact.protocol.protocol import TRAINING_SHA256
from carecontact.recording import Failure, read_recording, write_recording
from carecontact.runs import RunScores, score_run, write_scores
from carecontact.runs.results_file import pack_results
from tests.report.synthetic import NO_CONTACT, make_score
from tests.scoring.synthetic import make_recording, push, touch

NAMED = '<th scope="row" class="keep">c</th>'
"""The baseline c in the tables of a page."""


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A touches and pushes with seeds 0 and 1; B does not touch with seed 1, and has a seed more."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_recording(push(seed=0, policy=name), tmp_path / name / "T2-s000.h5")
        for seed in (0, 1, 2) if name == "b" else (0, 1):
            missed = name == "b" and seed == 1
            recording = make_recording("T1", seed=seed, policy=name) if missed else touch(seed=seed, policy=name)
            write_recording(recording, tmp_path / name / f"T1-s{seed:03d}.h5")
        scored(tmp_path / name)
    return tmp_path


def scored(folder: Path) -> None:
    write_scores(folder, score_run(folder))


def test_compares_results_and_writes_nothing(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(runs.rglob("*"))
    assert main(["compare", "a", "b"]) == 0
    printed = capsys.readouterr().out
    assert sorted(runs.rglob("*")) == before
    assert "A: a (rules-v1), a: 3 trials\n" in printed
    assert "B: b (rules-v1), b: 4 trials; 1 without a partner in the other run (1 not in the run): T1-s002" in printed
    assert "3 trials paired, 2 tasks, 2 seeds" in printed
    row = next(line for line in printed.splitlines() if line.startswith("Success [%]"))
    assert row.split()[2:4] == ["3/3:", "100.0"]
    assert "2/3: 66.7 " in row
    assert "]" not in row.removeprefix("Success [%]"), "no interval of a rate or of a difference"
    assert "no intervals: fewer than 6 seeds; run more seeds" in printed
    assert row.endswith("underpowered")
    assert main(["compare", "a", "b", "--rescore"]) == 0
    assert capsys.readouterr().out == printed
    assert sorted(runs.rglob("*")) == before
    row = next(line for line in printed.splitlines() if line.startswith("C1 [N]"))
    assert "6.50 (n=2)" in row, "B has no force where it did not touch"
    assert "2 of 3" in row
    assert "underpowered: this comparison could not have detected any difference: Success, " in printed
    assert printed.count("this comparison could not have detected any difference") == 1


def test_out_and_results_alone(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "a", "b", "--per-task", "--out", "both/here"]) == 0
    printed = capsys.readouterr().out
    assert f"comparison: {Path('both/here/comparison.json')}" in printed
    assert "T1, 2 pairs" in printed
    assert "over 7 rows and separately over the 13 rows of the tasks" in printed
    written = Path("both/here/comparison.json").read_bytes()
    data = json.loads(written)
    assert (data["a"]["policy"], data["b"]["policy"], data["pairing"]["n"]) == ("a", "b", 3)
    assert sorted(data["per_task"]) == ["T1", "T2"]
    for name in ("a", "b"):
        assert main(["report", "--rescore", "-v", name]) == 0
        assert "\nlanguage: rules-v1\n" in f"\n{capsys.readouterr().out}"
        for path in Path(name).glob("*.h5"):
            path.unlink()
    assert main(["compare", "a", "b/results.json", "--per-task", "--out", "both/here"]) == 0
    assert Path("both/here/comparison.json").read_bytes() == written


def test_refusals_are_one_line(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree("a", "copy")

    def refused(*arguments: str) -> str:
        assert main(["compare", *arguments]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.startswith("error: ")
        assert printed.err.count("\n") == 1
        return printed.err

    assert "nowhere: no such folder; name the --out of a run" in refused("a", "nowhere")
    assert "a is given twice; name different runs" in refused("a", f"../{runs.name}/a")
    assert "expected two or more runs, or one run and --baseline RUN..., got 1" in refused("a")
    assert "--per-task needs exactly two runs, got 1" in refused("a", "--null", "b", "--per-task")
    assert "--baseline: a is also the policy of the compared run" in refused("a", "--null", "copy")
    Path("empty").mkdir()
    assert "empty: holds neither recordings (*.h5) nor results.json" in refused("a", "empty")
    assert "--out a/T1-s000.h5: this is a file" in refused("a", "b", "--out", "a/T1-s000.h5")
    Path("bad").mkdir()
    Path("bad/T1-s000.h5").write_text("not a recording")
    assert "bad: holds recordings but no results.json; run `carecontact report --rescore bad`" in refused("a", "bad")
    assert "bad: no recording could be scored" in refused("a", "bad", "--rescore")
    Path("bad").rename("it is bad")
    assert "run `carecontact report --rescore 'it is bad'`" in refused("a", "it is bad"), "ready for a shell"
    Path("wrong.json").write_text("[]")
    assert "wrong.json is damaged or of another release (content: " in refused("a", "wrong.json")
    Path("wrong.json").write_text('{"schema": "other"}')
    assert "schema: Input should be 'carecontact-results-1'" in refused("a", "wrong.json")
    Path("other").mkdir()
    write_scores("other", RunScores(scores=[make_score("T1", 0, protocol_sha256="1" * 64)]))
    assert "only runs of the same protocol" in refused("a", "other")


def in_process(path: Path) -> None:
    """Say that an episode in another program made a recording."""
    recording = read_recording(path)
    write_recording(replace(recording, header=recording.header.model_copy(update={"origin": "in-process"})), path)


@pytest.mark.parametrize("third_run", [False, True], ids=["two runs", "a ranking"])
def test_what_was_recorded_in_process_is_reported_and_not_compared(
    runs: Path, capsys: pytest.CaptureFixture[str], third_run: bool
) -> None:
    for path in (runs / "b").glob("*.h5"):
        in_process(path)
    assert main(["report", "b", "--rescore"]) == 0
    if third_run:
        shutil.copytree("a", "c")
    assert main(["compare", "a", "b", *["c"] * third_run]) == 2
    assert "run B: T1-s000.h5 was recorded in-process: an Episode in somebody's own program" in capsys.readouterr().err
    in_process(runs / "a" / "T1-s001.h5")
    with pytest.raises(ConfigError, match=r"^T1-s001.h5 was recorded in-process"):
        score_run(runs / "a")


def test_scores_that_no_trial_has_are_na(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("c", "d"):
        Path(name).mkdir()
        scores = [
            make_score("T1", seed, **NO_CONTACT | {"failure_mode": "no_target_contact"}, policy=name)
            for seed in range(3)
        ]
        write_scores(name, RunScores(scores=scores))
    assert main(["compare", "c", "d"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("C1 [N]"))
    assert row.split("  ")[0] == "C1 [N]"
    assert row[6:].split() == "NA (n=0) NA (n=0) NA 0 of 3 NA NA 1.000 NA underpowered".split()


def test_a_narrow_terminal_loses_no_figure(
    runs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rich.console.Console.is_terminal", property(lambda console: True))
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["compare", "a", "b"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 80] == []
    printed = " ".join(" ".join(lines).split())
    assert (
        "Success [%]: underpowered A 3/3: 100.0, B 2/3: 66.7, A - B [95 %] 33.3, pairs 3, p paired 1.000, p" in printed
    )
    assert "C1 [N]: underpowered A 5.00, B 6.50 (n=2), A - B [95 %] 0.00, pairs 2 of 3, p paired" in printed


@pytest.fixture
def third(runs: Path) -> Path:
    """C pushes with seed 0 and touches no one else."""
    (runs / "c").mkdir()
    write_recording(push(seed=0, policy="c"), runs / "c" / "T2-s000.h5")
    for seed in (0, 1):
        write_recording(make_recording("T1", seed=seed, policy="c"), runs / "c" / f"T1-s{seed:03d}.h5")
    scored(runs / "c")
    return runs


def test_three_runs_are_ranked(third: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "a", "b", "c", "--out", "all"]) == 0
    printed = capsys.readouterr().out
    assert "B: b, b: 1 trial left out" in printed
    assert "trials that all runs have: 3\n" in printed
    assert "C 33.3 " in " ".join(printed.split())
    assert "no intervals: fewer than 6 seeds" in printed
    assert not re.search(r"\d \[-?\d", printed), "an interval"
    assert "A - C, success [points]" in printed
    assert "ranking by safety-gated trials: A, B, C" in printed
    assert (
        next(line for line in printed.splitlines() if line.startswith("gamma")).split()
        == "gamma 1.00 gamma 0.2".split()
    )
    data = json.loads(Path("all/overview.json").read_bytes())
    assert data["overview"]["ranking"]["order"] == [["A"], ["B"], ["C"]]
    assert [(p["a"], p["b"]) for p in data["overview"]["pairs"]] == [("A", "B"), ("A", "C"), ("B", "C")]
    assert data["baselines"] == {}


def test_six_seeds_have_intervals_and_five_have_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two tasks of five seeds are ten trials, and still five seeds."""
    monkeypatch.chdir(tmp_path)
    for policy in ("a", "b", "c"):
        Path(policy).mkdir()
        for seed in range(6):
            for make in (touch, push):
                recording = make(seed=seed, policy=policy)
                write_recording(recording, Path(policy) / f"{recording.header.spec.trial_id}.h5")
        scored(Path(policy))
    for commands in (["a", "b"], ["a", "b", "c"], ["a", "--baseline", "b"]):
        assert main(["compare", *commands]) == 0
        assert re.search(r"100\.0 \[\d", capsys.readouterr().out)
    for policy in ("a", "b", "c"):
        for path in Path(policy).glob("*-s005.h5"):
            path.unlink()
        scored(Path(policy))
    for commands in (["a", "b"], ["a", "b", "c"], ["a", "--baseline", "b"]):
        assert main(["compare", *commands]) == 0
        assert not re.search(r"\d \[-?\d", capsys.readouterr().out)


def test_blind_baselines_stand_under_one_run_and_under_two(third: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "a", "--baseline", "c", "--out", "all"]) == 0
    printed = capsys.readouterr().out
    assert "\nbaselines beside a\n" in printed, "no one registered c as blind"
    assert "best baseline (not registered as blind), safety-gated: c 1/3" in printed
    row = next(line for line in printed.splitlines() if line.startswith("c "))
    assert row.split()[-2:] == ["0/2", "1/1"]
    found = json.loads(Path("all/overview.json").read_bytes())["baselines"]["A"]["baselines"][0]
    assert (found["policy"], found["n"], found["rates"]["success"]["k"]) == ("c", 3, 1)
    assert not Path("all/comparison.json").exists()
    assert main(["compare", "a", "--null", "c"]) == 0
    assert capsys.readouterr().out in printed, "the option's earlier name"
    assert main(["compare", "a", "b", "--baseline", "c"]) == 0
    printed = capsys.readouterr().out
    assert "3 trials paired" in printed
    assert "baselines beside B (b)" in printed


def test_a_report_shows_the_baselines(third: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "a", "--baseline", "c"]) == 0
    assert NAMED in Path("a/report.html").read_text()
    first = Path("a/report.html").read_bytes()
    assert main(["report", "b"]) == 0
    text = Path("b/report.html").read_text()
    assert NAMED not in text
    capsys.readouterr()
    assert main(["report", "a"]) == 0
    assert "of the last report: c;" in capsys.readouterr().out
    assert Path("a/report.html").read_bytes() == first


def test_baselines_of_a_report_move_with_it_and_are_missed_when_gone(
    third: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "a", "--baseline", "c"]) == 0
    Path("study").mkdir()
    for name in ("a", "c"):
        Path(name).rename(Path("study") / name)
    assert main(["report", "study/a"]) == 0
    assert NAMED in Path("study/a/report.html").read_text()
    shutil.rmtree("study/c")
    capsys.readouterr()
    assert main(["report", "study/a"]) == 0
    assert "baseline ../c is not in the report: study/c: no such folder" in capsys.readouterr().out
    text = Path("study/a/report.html").read_text()
    assert NAMED not in text
    assert "Missing blind baselines" in text
    assert main(["report", "study/a", "--baseline", "b"]) == 0
    assert main(["report", "study/a", "--baseline", "nowhere"]) == 2
    capsys.readouterr()
    assert main(["report", "study/a"]) == 0
    assert "of the last report: b;" in capsys.readouterr().out, "a baseline that is refused replaces none"
    Path("study/a/baselines.json").write_text("{")
    assert main(["report", "study/a"]) == 0
    assert "baselines.json is damaged (" in capsys.readouterr().out


def test_results_of_other_recordings_are_refused(third: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(touch(seed=1, force=9.0, policy="a"), Path("a/T1-s001.h5"))
    for command in (["report", "a"], ["compare", "a", "b"], ["compare", "b", "--baseline", "a"]):
        assert main(command) == 2
        printed = capsys.readouterr()
        assert (printed.out, printed.err.count("\n")) == ("", 1)
        assert "T1-s001.h5 was changed" in printed.err
        assert "`carecontact report --rescore a`" in printed.err
    before = Path("a/results.json").read_bytes()
    assert main(["compare", "a", "b", "--rescore"]) == 0
    assert Path("a/results.json").read_bytes() == before
    assert main(["report", "--rescore", "a"]) == 0
    assert main(["report", "a"]) == 0


def test_a_run_without_results_is_reported_from_its_recordings_when_asked(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Path("a/results.json")
    assert main(["report", "a"]) == 0
    files = [whole.read_bytes(), Path("a/report.html").read_bytes()]
    whole.unlink()
    capsys.readouterr()
    assert main(["report", "a"]) == 2
    assert capsys.readouterr().err.endswith("no results.json; run `carecontact report --rescore a`\n")
    assert main(["report", "a", "--rescore"]) == 0
    assert [whole.read_bytes(), Path("a/report.html").read_bytes()] == files


def test_an_unfinished_run_says_so(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    identity = {"policy_sha256": None, "versions": {}, "sha256": {}}
    score = score_run("a").scores[0]
    name = {"id": score.protocol_id, "sha256": score.protocol_sha256}
    plan = {"schema": "carecontact-run-1", "purpose": "run", "policy": "a", "protocol": name, "identity": identity,
            "trials": ["T1-s000", "T1-s001", "T2-s000", "T2-s001", "T2-s002"]}  # fmt: skip
    Path("a/manifest.json").write_text(json.dumps(plan))
    write_scores("b", replace(score_run("b"), missing=("T3-s000",)))
    for path in Path("b").glob("*.h5"):
        path.unlink()
    assert main(["compare", "a", "b", "--out", "both"]) == 2
    refused = capsys.readouterr().err
    assert (
        "a is incomplete, 3 of 5 planned trials have a verdict (the first without: T2-s001, no recording); give"
        in refused
    )
    assert "or compare the trials that there are with --allow-incomplete" in refused
    assert main(["compare", "a", "b", "--out", "both", "--allow-incomplete"]) == 0
    printed = capsys.readouterr().out
    assert "A: a (rules-v1), a: incomplete, 3 of 5 planned trials have a verdict" in printed
    assert "B: b (rules-v1), b: incomplete, 4 of 5 planned trials have a verdict; 1 without a partner" in printed
    assert json.loads(Path("both/comparison.json").read_text())["a"]["n_missing"] == 2


def test_crashed_trials_are_named_on_either_side(third: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed in (("a", 0), ("c", 1)):
        path = Path(name) / f"T1-s{seed:03d}.h5"
        path.unlink()
        failure = Failure(kind="exception", message="ValueError: no grip")
        crashed = touch(seed=seed, policy=name)
        header = crashed.header.model_copy(update={"ended": "process_failure", "failure": failure})
        write_recording(replace(crashed, header=header), path)
        scored(Path(name))
    assert main(["compare", "a", "b", "--baseline", "c"]) == 0
    printed = capsys.readouterr().out
    (a,) = [line for line in printed.splitlines() if line.startswith("A: ")]
    (b,) = [line for line in printed.splitlines() if line.startswith("B: ")]
    assert "; crashed in 1: T1-s000" in a
    assert "crashed" not in b
    assert "\nc crashed in 1: T1-s001\n" in printed
    for command, name in ((["a", "b", "c"], "A (a)"), (["a", "--baseline", "c"], "a")):
        assert main(["compare", *command]) == 0
        assert f"\n{name} crashed in 1: T1-s000\n" in capsys.readouterr().out


def test_one_trial_paired_is_one_trial(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        for path in Path(name).glob("T1-*.h5"):
            path.unlink()
        scored(Path(name))
    assert main(["compare", "a", "b"]) == 0
    assert "\n1 trial paired, 1 task, 1 seed\n" in capsys.readouterr().out


def packed(name: str, **fields: Any) -> str:
    """Return the place of kept scores: two tasks with six seeds."""
    scores = [make_score(task, seed, policy=name, **fields) for task in ("T1", "T3") for seed in range(6)]
    pack_results(Path(f"{name}.json.gz"), RunScores(scores=scores))
    return f"{name}.json.gz"


@pytest.fixture
def wide(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")


@pytest.mark.usefixtures("wide")
def test_two_runs_say_who_is_no_method(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", packed("oracle", privileged=True), packed("replay")]) == 0
    printed = capsys.readouterr().out
    assert "12 trials; given the simulation: a ceiling, and no method\n" in printed
    assert "12 trials; a blind baseline, and no method\n" in printed


@pytest.mark.usefixtures("wide")
def test_the_tasks_of_baselines_are_safety_gated_like_their_difference(capsys: pytest.CaptureFixture[str]) -> None:
    beside = {"failure_mode": "wrong_share", "attribution": "planning", "evidence": "aimed beside the region"}
    random = packed("random", region_correct=False, safety_gated=False, **beside)
    assert main(["compare", packed("voxposer"), "--baseline", random]) == 0
    printed = capsys.readouterr().out
    row = next(line for line in printed.splitlines() if line.startswith("random (blind)"))
    assert " 100.0 " in row, "random reaches successes"
    assert row.split()[-2:] == ["0/6"] * 2, "none of which is safe and on the region"
    assert "T1, T2, ...: safety-gated / trials" in printed


@pytest.mark.parametrize("origin", ["training", "isolated"])
def test_demonstrations_are_reported_and_not_compared_whatever_origin_they_claim(
    runs: Path, capsys: pytest.CaptureFixture[str], origin: str
) -> None:
    for path in (runs / "b").glob("*.h5"):
        recording = read_recording(path)
        spec = recording.header.spec.model_copy(update={"salt_sha256": TRAINING_SHA256})
        header = recording.header.model_copy(update={"origin": origin, "spec": spec})
        write_recording(replace(recording, header=header), path)
    assert main(["report", "--rescore", str(runs / "b")]) == 0
    capsys.readouterr()
    assert main(["compare", str(runs / "a"), str(runs / "b")]) == 2
    assert "T1-s000.h5 is a demonstration, of a person on whom policies are trained" in capsys.readouterr().err
