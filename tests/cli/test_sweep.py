"""``carecontact sweep`` over workers that only write recordings."""

from __future__ import annotations

import csv
import functools
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.cli import main
from carecontact.cli.result_answers import SweepCellAnswer
from carecontact.protocol.protocol import TrialSpec
from carecontact.running import supervisor
from carecontact.running.supervisor import EventKind, Run, TrialEvent
from carecontact.runs import scoring
from tests.running.forked_fakes import FAKE, fork_fakes
from tests.serving.served import WITHOUT_WAITING, served

PLAN = """
tasks = "T1"
seeds = "0-1"

[[policies]]
policy = "hover"

[[policies]]
policy = "zero-action"

[axes]
protocol = ["bathing-v3"]
body = ["man-adult", "woman-old-light"]
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    monkeypatch.setattr(supervisor, "open_run", functools.partial(supervisor.open_run, worker_command=FAKE))
    fork_fakes(monkeypatch)
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", "{}")
    monkeypatch.setenv("PYTHONPATH", str(Path(carecontact.__file__).parents[1]))
    monkeypatch.chdir(tmp_path)
    Path("p.toml").write_text(PLAN)
    return monkeypatch


def ran() -> int:
    return len(Path("ran.txt").read_text().splitlines())


def rows() -> list[dict[str, str]]:
    with Path("s/sweep.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_sweep_is_a_run_for_each_cell_and_one_table(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sweep", "p.toml", "--out", "s", "--dry-run", "--json"]) == 0
    lines = [SweepCellAnswer.model_validate_json(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line.policy, line.values, line.trials, line.recorded) for line in lines[:2]] == [
        (policy, {"protocol": "bathing-v3", "body": "man-adult"}, 2, 0) for policy in ("hover", "zero-action")
    ]
    assert len(lines) == 4
    assert main(["sweep", "p.toml", "--out", "s", "--dry-run"]) == 0
    assert capsys.readouterr().out.count("2 trials\n") == 4
    assert not Path("s").exists()
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "2"]) == 0
    printed = capsys.readouterr().out
    assert "p.toml: 4 cells, 8 trials, into s\n" in printed
    assert "8 trials in " in printed
    assert "at most 2 at once: " in printed
    assert [(row["policy"], row["body"], row["trials"], row["safety_gated"]) for row in rows()] == [
        (policy, body, "2", "0") for body in ("man-adult", "woman-old-light") for policy in ("hover", "zero-action")
    ]
    for row in rows():
        results = json.loads((Path("s") / row["folder"] / "results.json").read_text())
        assert results["policy"] == row["policy"]
        assert results["protocol"]["overrides"] == ({} if row["body"] == "man-adult" else {"person.body": row["body"]})
    requests = Path("requests.jsonl").read_text().splitlines()
    assert all(str(Path("s").resolve()) in json.loads(request)["policy"]["closed"] for request in requests)
    pages = {name: Path("s", name).read_bytes() for name in ("sweep.html", "sweep.md", "sweep.csv")}
    assert b"woman-old-light" in pages["sweep.html"]
    before = ran()
    assert main(["sweep", "p.toml", "--out", "s"]) == 0
    assert ran() == before, "what is finished does not run again"
    assert "8 trials were finished already" in capsys.readouterr().out
    assert {name: Path("s", name).read_bytes() for name in pages} == pages


def test_trials_are_scored_in_other_processes(fake: pytest.MonkeyPatch) -> None:
    here = list[Path]()
    score_files = scoring.score_files
    fake.setattr(scoring, "score_files", lambda paths, **more: here.extend(paths) or score_files(paths, **more))
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "2"]) == 0
    cell = Path("s") / rows()[0]["folder"]
    before = (cell / "results.json").read_bytes()
    (cell / "results.json").unlink()
    assert main(["sweep", "p.toml", "--out", "s"]) == 0
    assert (cell / "results.json").read_bytes() == before
    assert here == []


def test_cells_are_finished_one_after_another(fake: pytest.MonkeyPatch) -> None:
    begun: list[str] = []
    report = Run._report

    def message(run: Run, kind: EventKind, trial_id: str, **more: Any) -> None:
        if kind == "started":
            begun.append(run._out.name)
        report(run, kind, trial_id, **more)

    fake.setattr(Run, "_report", message)
    Path("p.toml").write_text(PLAN.replace("0-1", "0-3"))
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "2"]) == 0
    assert begun == [name for name in dict.fromkeys(begun) for _ in range(4)]


def stop_after(trials: int, patch: pytest.MonkeyPatch) -> None:
    """Ctrl-C as soon as so many have finished."""
    report, left = Run._report, [trials]

    def stop(run: Run, kind: EventKind, trial_id: str, **more: Any) -> None:
        report(run, kind, trial_id, **more)
        left[0] -= kind == "finished"
        if not left[0]:
            raise KeyboardInterrupt

    patch.setattr(Run, "_report", stop)


def test_a_sweep_that_is_stopped_twice_resumes_where_it_was(fake: pytest.MonkeyPatch) -> None:
    for trials, stored in ((1, 1), (4, 5)):
        with pytest.MonkeyPatch.context() as patch:
            stop_after(trials, patch)
            assert main(["sweep", "p.toml", "--out", "s", "--jobs", "1"]) == 130
        assert len(list(Path("s").rglob("*.h5"))) == stored
        assert not Path("s/sweep.csv").exists()
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "1"]) == 0
    assert [row["trials"] for row in rows()] == ["2"] * 4
    assert ran() == 8, "no finished trial ran again"


def test_the_parts_of_a_sweep_share_a_folder(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "p.toml", "--out", "s", "--shard", "1/2"]) == 0
    assert [row["trials"] for row in rows()] == ["2", "0", "2", "0"]
    assert "Incomplete: 2 cells lack the verdict on planned trials;" in capsys.readouterr().out
    assert main(["sweep", "p.toml", "--out", "s", "--shard", "2/2"]) == 0
    assert [row["trials"] for row in rows()] == ["2"] * 4
    assert main(["sweep", "p.toml", "--out", "s", "--shard", "5/5"]) == 2
    assert "--shard 5/5: there are 4 cells; give at most as many parts" in capsys.readouterr().err


def test_parts_in_several_folders_become_one_sweep(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for part in ("1/2", "2/2"):
        assert main(["sweep", "p.toml", "--out", part[0], "--shard", part]) == 0
    # The second machine has also run half of a cell of the first.
    first = sorted(Path("1/cells").iterdir())[0].name
    Path("1/cells", first, "T1-s001.h5").unlink()
    assert main(["merge", "s", "1"]) == 1
    assert f"s/cells/{first}: 1 planned trial has no recording: T1-s001\n" in capsys.readouterr().out
    (half := Path("2/cells", first)).mkdir()
    for name in ("manifest.json", "T1-s000.h5"):
        half.joinpath(name).write_bytes(Path("1/cells", first, name).read_bytes())
    Path("1/cells", first, "T1-s000.h5").rename(Path("1/cells", first, "aside"))
    assert main(["sweep", "p.toml", "--out", "1", "--shard", "1/2"]) == 0
    assert main(["merge", "s", "1", "2"]) == 0
    out = capsys.readouterr().out
    assert "2 parts, 4 cells: 5 recordings copied into s, 3 were there already\n" in out
    assert "carecontact sweep PLAN.toml --out s --table-only" in out
    before = ran()
    assert main(["sweep", "p.toml", "--out", "s", "--table-only"]) == 0
    assert [row["trials"] for row in rows()] == ["2"] * 4
    assert main(["sweep", "p.toml", "--out", "s"]) == 0, "and the sweep goes on there"
    assert ran() == before


def test_what_is_no_part_of_a_sweep_is_refused(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "p.toml", "--out", "s", "--seeds", "0"]) == 0
    cell = sorted(Path("s/cells").iterdir())[0]
    for parts, message in (
        (["s", str(cell)], f"{cell} is not a sweep: it holds no folder cells"),
        (["s", "s"], "s is given twice"),
        (["s", "nothing"], "nothing is not a sweep"),
    ):
        assert main(["merge", "merged", *parts]) == 2
        assert message in capsys.readouterr().err
        assert not Path("merged").exists()


def test_a_piece_of_a_plan_is_a_beginning_of_the_whole(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sweep", "p.toml", "--out", "s", "--seeds", "1", "--tasks", "T1"]) == 0
    assert [row["planned"] for row in rows()] == ["1"] * 4
    capsys.readouterr()
    assert main(["sweep", "p.toml", "--out", "s", "--dry-run", "--json"]) == 0
    lines = [SweepCellAnswer.model_validate_json(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line.policy, line.values, line.trials, line.recorded) for line in lines[:2]] == [
        (policy, {"protocol": "bathing-v3", "body": "man-adult"}, 2, 1) for policy in ("hover", "zero-action")
    ]
    assert len(lines) == 4
    assert main(["sweep", "p.toml", "--out", "s", "--dry-run"]) == 0
    assert capsys.readouterr().out.count(": 2 trials, 1 recorded\n") == 4
    assert main(["sweep", "p.toml", "--out", "s"]) == 0
    assert ran() == 8
    assert main(["sweep", "p.toml", "--out", "s", "--seeds", "77"]) == 2
    assert "plan p.toml: seeds: '77' contains seeds that bathing-v3 does not have" in capsys.readouterr().err


def test_a_stopped_sweep_has_a_table_on_request(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "p.toml", "--out", "s", "--table-only"]) == 2
    assert "s: no such folder" in capsys.readouterr().err
    with pytest.MonkeyPatch.context() as patch:
        stop_after(3, patch)
        assert main(["sweep", "p.toml", "--out", "s", "--jobs", "1"]) == 130
    assert main(["sweep", "p.toml", "--out", "s", "--table-only"]) == 0
    assert [row["trials"] for row in rows()] == ["2", "1", "0", "0"]
    assert len(list(Path("s").rglob("results.json"))) == 1, "nothing is written into a cell that may be running"
    assert ran() == 3


def test_a_server_that_no_trial_needs_may_be_away(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake.setattr("carecontact.serving.opening.FIRST_PAUSE_S", WITHOUT_WAITING)
    Path("p.toml").write_text(PLAN.replace('"zero-action"', '"ws://127.0.0.1:9"'))
    assert main(["sweep", "p.toml", "--out", "s"]) == 2
    assert capsys.readouterr().err.startswith("error: plan p.toml: policies: ws://127.0.0.1:9 does not answer")
    assert main(["sweep", "p.toml", "--out", "s", "--shard", "1/2"]) == 0
    assert [row["trials"] for row in rows()] == ["2", "0", "2", "0"]


def test_one_noise_salt_serves_all_cells_that_have_noise(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    salt = "0123456789abcdef" * 2
    assert main(["sweep", "p.toml", "--out", "s", "--noise-salt", salt]) == 2
    assert "--noise-salt: no protocol of this plan has sensor noise" in capsys.readouterr().err
    levels = 'protocol = ["bathing-wide-v2"]\nlevel = ["L1", "L2"]'
    Path("p.toml").write_text(PLAN.partition("protocol =")[0] + levels)
    assert main(["sweep", "p.toml", "--out", "s", "--noise-salt", salt[1:]]) == 2
    assert "--noise-salt: expected 32 hexadecimal digits" in capsys.readouterr().err
    assert main(["sweep", "p.toml", "--out", "s", "--noise-salt", salt]) == 0
    manifests = {row["folder"]: json.loads(Path("s", row["folder"], "manifest.json").read_text()) for row in rows()}
    assert [manifest.get("noise_salt") for manifest in manifests.values()] == [None, None, salt, salt]


def test_the_other_policies_go_on_without_a_server_that_stays_away(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s001": "unreached_server"}))
    with served("class P(Base): pass", tmp_path) as (port, _):
        Path("p.toml").write_text(PLAN.replace('"hover"', f'"ws://127.0.0.1:{port}"'))
        assert main(["sweep", "p.toml", "--out", "s", "--jobs", "1"]) == 2
        assert capsys.readouterr().err == (
            "error: nothing listens there; then run the missing trials with: carecontact sweep p.toml --out s "
            "--jobs 1\n"
        )
        assert [row["trials"] for row in rows()] == ["1", "2", "0", "2"]
        fake.setenv("FAKE_PLAN", "{}")
        assert main(["sweep", "p.toml", "--out", "s"]) == 0
    assert [row["trials"] for row in rows()] == ["2"] * 4
    assert ran() == 6 + 3


def test_policies_behind_one_address_share_its_limit(fake: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with served("class P(Base): pass", tmp_path) as (port, _):
        entry = f'"ws://127.0.0.1:{port}"\njobs = 1\nlabel = '
        Path("p.toml").write_text(PLAN.replace('"hover"', f'{entry}"a"').replace('"zero-action"', f'{entry}"b"'))
        most = most_at_once(fake)
        assert main(["sweep", "p.toml", "--out", "s", "--jobs", "4"]) == 0
    assert list(most.values()) == [1]
    assert [row["trials"] for row in rows()] == ["2"] * 4


def test_a_policy_may_be_given_folders(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    Path("p.toml").write_text(PLAN.replace('"zero-action"', '"zero-action"\nread = ["weights"]'))
    assert main(["sweep", "p.toml", "--out", "s"]) == 2
    assert "plan p.toml: policies: --policy-read" in capsys.readouterr().err
    Path("weights").mkdir()
    assert main(["sweep", "p.toml", "--out", "s"]) == 0
    asked = [json.loads(line) for line in Path("requests.jsonl").read_text().splitlines()]
    readable = [each["policy"]["readable"] for each in asked if each["spec"]["policy"] == "zero-action"]
    assert readable == [[str(Path("weights").resolve())]] * 4


def most_at_once(fake: pytest.MonkeyPatch) -> Counter[str]:
    """Policy -> most trials of it that run at the same time from now on."""
    running, most = Counter[str](), Counter[str]()
    made = supervisor.open_run

    def opened(specs: Sequence[TrialSpec], **options: Any) -> Any:
        on_event, policy = options["on_event"], specs[0].policy

        def message(event: TrialEvent) -> None:
            running[policy] += (event.kind == "started") - (event.kind == "finished")
            most[policy] = max(most[policy], running[policy])
            on_event(event)

        return made(specs, **{**options, "on_event": message})

    fake.setattr(supervisor, "open_run", opened)
    return most


def test_a_policy_has_no_more_trials_at_once_than_its_plan_says(fake: pytest.MonkeyPatch) -> None:
    Path("p.toml").write_text(PLAN.replace('"zero-action"', '"zero-action"\njobs = 1'))
    most = most_at_once(fake)
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "4"]) == 0
    assert most["zero-action"] == 1
    assert most["hover"] > 1
    assert [row["trials"] for row in rows()] == ["2"] * 4


def test_failures_of_a_cell_are_named_and_give_the_status(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy"}))
    assert main(["sweep", "p.toml", "--out", "s"]) == 3
    assert "_man-adult_" in capsys.readouterr().out
    assert [row["crashed"] for row in rows()] == ["1"] * 4
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "exit"}))
    assert main(["sweep", "p.toml", "--out", "s", "--retry-failed"]) == 1
    assert [(row["harness_errors"], row["trials"]) for row in rows()] == [("1", "1")] * 4
    assert "The harness failed in 4 trials, which have no verdict." in Path("s/sweep.md").read_text()


def test_what_is_suspect_about_a_policy_is_named_in_one_of_its_cells(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "answers"}))
    assert main(["sweep", "p.toml", "--out", "s"]) == 0
    printed = [line for line in capsys.readouterr().out.splitlines() if "warning: the first answer" in line]
    assert [line.split("] ")[1].split("_")[0] for line in printed if "quaternion" in line] == ["hover", "zero-action"]
    assert len(printed) == 4, "two lines about each"


def test_a_wrong_plan_is_one_line_and_makes_no_folder(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for old, new, message in (
        ('"zero-action"', '"zero"', "plan p.toml: policies: no policy named 'zero' (did you mean 'zero-action'?)"),
        ('"zero-action"', '"zero-action"\narguments = { x = 1 }', "zero-action"),
        ("body", "bodies", "plan p.toml: axes.bodies: no such axis (did you mean 'body'?)"),
    ):
        Path("p.toml").write_text(PLAN.replace(old, new))
        assert main(["sweep", "p.toml", "--out", "s"]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert not Path("s").exists()


def test_a_sweep_tells_its_table_as_json(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    Path("p.toml").write_text(PLAN.partition("protocol =")[0] + 'protocol = ["bathing-v3", "bathing-wide-v2 L1"]')
    assert main(["sweep", "p.toml", "--out", "s", "--json"]) == 0
    out = capsys.readouterr()
    (line,) = out.out.splitlines()
    answer = json.loads(line)
    assert (answer["schema"], answer["trials"], answer["planned"]) == ("carecontact-sweep-1", 8, 8)
    assert [rung["value"] for rung in answer["ladder"]["rungs"]] == ["bathing-v3", "bathing-wide-v2 L1"]
    assert {climb["role"] for rung in answer["ladder"]["rungs"] for climb in rung["climbs"]} == {"blind"}
    assert "table: s/sweep.html" in out.err
    assert "Success over level" in Path("s/sweep.html").read_text()
