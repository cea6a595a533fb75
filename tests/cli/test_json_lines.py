"""Every line that `--json` prints is one JSON object of a schema that is shipped."""

from __future__ import annotations

import functools
import json
import os
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from tools.json_schemas import FOLDER, written

import carecontact
from carecontact.cli import main
from carecontact.cli.result_answers import ANSWERS, name_of
from carecontact.episode import placed_persons
from carecontact.episode.placed_persons import PlacementSurvey
from carecontact.lab.validation import energy
from carecontact.lab.validation.result import CheckResult, Measure
from carecontact.recording import write_recording
from carecontact.running import machine, supervisor
from carecontact.runs import score_run, write_scores
from tests.running.forked_fakes import FAKE, fork_fakes
from tests.scoring.synthetic import make_recording, push, touch


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    """What standard output holds, each line checked against the schema that it names."""
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    for line in found:
        schema = json.loads((FOLDER / f"{line['schema']}.json").read_text())
        jsonschema.Draft202012Validator(schema).validate(line)
    return found


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A touches and pushes; B does neither with seed 1; C is like A."""
    monkeypatch.chdir(tmp_path)
    for name in "abc":
        (tmp_path / name).mkdir()
        for seed in (0, 1):
            missed = name == "b" and seed == 1
            made = make_recording("T1", seed=seed, policy=name) if missed else touch(seed=seed, policy=name)
            write_recording(made, tmp_path / name / f"T1-s{seed:03d}.h5")
        write_recording(push(seed=0, policy=name), tmp_path / name / "T2-s000.h5")
        write_scores(tmp_path / name, score_run(tmp_path / name))
    return tmp_path


def test_the_shipped_schemas_are_those_of_the_models() -> None:
    assert {path.name: path.read_text() for path in FOLDER.iterdir()} == written(), "run tools/json_schemas.py"
    assert len({name_of(answer) for answer in ANSWERS}) == len(ANSWERS)


def test_a_name_that_is_not_utf8_is_escaped(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in "ab":
        (runs / name / os.fsdecode(b"\xff.h5")).write_bytes(b"")
        write_scores(runs / name, score_run(runs / name))
    assert main(["compare", "a", "b", "--json"]) == 0
    (answer,) = lines(capsys)
    assert "\\udcff.h5" in json.dumps(answer).replace("\\\\", "\\")


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "tasks", "--json"]) == 0
    (line,) = lines(capsys)
    assert [row["name"] for row in line["names"]["tasks"]] == ["T1", "T2", "T3", "T4", "T5", "T6", "T7"]
    assert main(["list", "--json"]) == 0
    assert {"policies", "metrics", "bodies"} <= lines(capsys)[0]["names"].keys()


def test_doctor(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    broken = machine.Finding(name="OpenGL", fine=False, detail="nothing", fix="apt-get")
    monkeypatch.setattr(machine, "findings", lambda: iter([broken]))
    assert main(["doctor", "--json"]) == 1
    (line,) = lines(capsys)
    assert line["fine"] is False
    assert line["findings"][0]["fix"] == "apt-get"


def test_run_tells_each_trial_as_it_ends(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(supervisor, "run_trials", functools.partial(supervisor.run_trials, worker_command=FAKE))
    fork_fakes(monkeypatch)
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T2-s000": "exit"}))
    monkeypatch.setenv("PYTHONPATH", str(Path(carecontact.__file__).parents[1]))
    monkeypatch.chdir(tmp_path)
    command = ["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0", "--out", "r", "--jobs", "1", "--json"]
    assert main(command) == 1
    *trials, last = lines(capsys)
    assert [(t["trial_id"], t["ended"], t["done"], t["total"]) for t in trials] == [
        ("T1-s000", "done", 1, 2), ("T2-s000", "harness_error", 2, 2)
    ]  # fmt: skip
    assert trials[0]["score"]["trial_id"] == "T1-s000"
    assert trials[1]["message"]
    assert (last["schema"], last["status"], last["overall"]["n_episodes"]) == ("carecontact-run-1", 1, 1)
    assert last["ran"] == ["T1-s000", "T2-s000"]

    assert (last["overall"]["n_planned"], last["overall"]["pc_success"]) == (2, None)

    assert main(command) == 1, "the same command repeats what the machine caused"
    *trials, last = lines(capsys)
    assert [(t["trial_id"], t["kept"]) for t in trials] == [("T1-s000", True), ("T2-s000", False)]
    assert (last["ran"], last["kept"]) == (["T2-s000"], ["T1-s000"])


def test_score(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (runs / "a" / "T7-s000.h5").write_bytes(b"no recording")
    assert main(["report", "--rescore", "a", "--json"]) == 1
    (line,) = lines(capsys)
    assert (line["status"], line["results"], list(line["skipped"])) == (1, "a/results.json", ["T7-s000.h5"])
    assert line["overall"]["n_success"] == 3
    assert line["per_task"]["T1"]["n_episodes"] == 2
    assert main(["report", "--rescore", "b", "--append", "--json"]) == 0
    assert lines(capsys)[0]["added"] == []


def test_compare(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "a", "b", "--per-task", "--out", "o", "--json"]) == 0
    (line,) = lines(capsys)
    stored = json.loads((runs / "o" / "comparison.json").read_text())
    assert {key: stored[key] for key in line["comparison"]} == line["comparison"]
    assert line["comparison"]["overall"][0]["unpaired"]["odds_ratio"] is None, "infinite"
    assert main(["compare", "a", "b", "c", "--json"]) == 0
    (line,) = lines(capsys)
    assert line["overview"]["n"] == 3
    assert main(["compare", "a", "--baseline", "b", "--json"]) == 0
    (line,) = lines(capsys)
    assert line["baselines"]["A"]["baselines"][0]["n"] == 3


def test_protocol(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["protocol", "list", "--json"]) == 0
    assert "bathing-v3" in {row["id"] for row in lines(capsys)[0]["protocols"]}
    assert main(["protocol", "show", "bathing-v3", "--json"]) == 0
    assert lines(capsys)[0]["fields"]["tasks"][0]["id"] == "T1"
    own = tmp_path / "own.toml"
    own.write_text('base = "bathing-v3"\nid = "own-1"\ndescription = "mine"\nfrozen = true\n')
    assert main(["protocol", "verify", str(own), "--json"]) == 1
    (line,) = lines(capsys)
    assert (line["equal"], line["differences"]) == (False, [])
    assert main(["protocol", "lock", str(own), "--json"]) == 0
    assert Path(lines(capsys)[0]["lock"]).is_file()
    assert main(["protocol", "verify", str(own), "--json"]) == 0
    assert lines(capsys)[0]["equal"] is True


def test_validate(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    measures = (
        Measure(name="made up", value=float("nan"), unit="J", limit=1.0),
        Measure(name="without a limit", value=2.0),
    )
    found = CheckResult(check="energy", title=energy.TITLE, measures=measures)
    monkeypatch.setattr(energy, "run", lambda subject, *, quick: found)
    monkeypatch.setattr(energy, "draw", lambda result, figure: figure.subplots())
    assert main(["verify", "physics", "--quick", "--checks", "energy", "--out", str(tmp_path / "out"), "--json"]) == 1
    (line,) = lines(capsys)
    assert line["passed"] is False
    assert [m["met"] for m in line["bodies"][0]["checks"][0]["measures"]] == [False, None]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["report", "--rescore", "nowhere", "--json"], "ConfigError"),
        (["list", "planets", "--json"], "UsageError"),
        (["report", "nowhere", "--json"], "ConfigError"),
        (["doctor", "--jsn", "--json"], "UsageError"),
        (["--json"], "UsageError"),
    ],
)
def test_an_error_is_one_line_too(arguments: list[str], error: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    printed = capsys.readouterr()
    line = json.loads(printed.out)
    jsonschema.validate(line, json.loads((FOLDER / "carecontact-error-1.json").read_text()))
    assert (line["error"], line["status"]) == (error, 2)
    assert printed.err.startswith(f"error: {line['message']}")


def test_an_interruption_is_one_line_too(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(machine, "findings", interrupted)
    assert main(["doctor", "--json"]) == 130
    assert lines(capsys)[0]["error"] == "Interrupted"


def test_what_people_read_goes_to_standard_error(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "--rescore", "a"]) == 0
    before = capsys.readouterr().out
    assert main(["report", "--rescore", "a", "--json"]) == 0
    printed = capsys.readouterr()
    assert printed.err == before
    assert len(printed.out.splitlines()) == 1


def test_feasible_draws_a_map_only_where_it_is_asked_for_beside_json(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def none_fits(protocol: object, seed: int, *, salt: str = "") -> PlacementSurvey:
        return PlacementSurvey(seed=seed, salt=salt, found=None, why="no base serves it")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(placed_persons, "survey_placement", none_fits)
    asked = ["protocol", "feasible", "bathing-wide-v2", "--level", "L2", "--seeds", "0", "--json"]
    assert main(asked) == 1
    (line,) = lines(capsys)
    assert [row["feasible"] for row in line["seeds"]] == [False]
    assert list(tmp_path.iterdir()) == []
    assert main([*asked, "--picture", "map.svg"]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["map.svg"]
    assert main(asked[:-1]) == 1
    assert (tmp_path / "feasible.png").exists()
