"""``carecontact sweep`` over workers that only write recordings."""

from __future__ import annotations

import csv
import functools
import json
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.cli import main
from carecontact.contract.trial import TrialSpec
from carecontact.trials import supervisor
from carecontact.trials.supervisor import EventKind, Run, TrialEvent

FAKE = (sys.executable, str(Path(__file__).parents[1] / "trials" / "fake_worker.py"))
PLAN = """
tasks = "T1"
seeds = "0-1"

[[policies]]
policy = "hover"

[[policies]]
policy = "zero-action"

[axes]
body = ["man-adult", "woman-old-light"]
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    monkeypatch.setattr(supervisor, "open_run", functools.partial(supervisor.open_run, worker_command=FAKE))
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
    assert main(["sweep", "p.toml", "--out", "s", "--dry-run"]) == 0
    assert capsys.readouterr().out.count("2 trial(s)\n") == 4
    assert not Path("s").exists()
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "2"]) == 0
    told = capsys.readouterr().out
    assert "p.toml: 4 cell(s), 8 trial(s), into s\n" in told
    assert "8 trial(s) in " in told
    assert "at most 2 at once: " in told
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
    assert "8 trial(s) were finished already" in capsys.readouterr().out
    assert {name: Path("s", name).read_bytes() for name in pages} == pages


def test_cells_are_finished_one_after_another(fake: pytest.MonkeyPatch) -> None:
    begun: list[str] = []
    report = Run._report

    def told(run: Run, kind: EventKind, trial_id: str, **more: Any) -> None:
        if kind == "started":
            begun.append(run._out.name)
        report(run, kind, trial_id, **more)

    fake.setattr(Run, "_report", told)
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
    assert "Unfinished: 2 cells lack trials." in capsys.readouterr().out
    assert main(["sweep", "p.toml", "--out", "s", "--shard", "2/2"]) == 0
    assert [row["trials"] for row in rows()] == ["2"] * 4


def test_a_policy_has_no_more_trials_at_once_than_its_plan_says(fake: pytest.MonkeyPatch) -> None:
    Path("p.toml").write_text(PLAN.replace('"zero-action"', '"zero-action"\njobs = 1'))
    running, most = Counter[str](), Counter[str]()
    made = supervisor.open_run

    def opened(specs: Sequence[TrialSpec], **options: Any) -> Any:
        on_event, policy = options["on_event"], specs[0].policy

        def told(event: TrialEvent) -> None:
            running[policy] += (event.kind == "started") - (event.kind == "finished")
            most[policy] = max(most[policy], running[policy])
            on_event(event)

        return made(specs, **{**options, "on_event": told})

    fake.setattr(supervisor, "open_run", opened)
    assert main(["sweep", "p.toml", "--out", "s", "--jobs", "4"]) == 0
    assert most["zero-action"] == 1
    assert most["hover"] > 1
    assert [row["trials"] for row in rows()] == ["2"] * 4


def test_failures_of_a_cell_are_told_and_give_the_status(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy"}))
    assert main(["sweep", "p.toml", "--out", "s"]) == 3
    assert "_man-adult_" in capsys.readouterr().out
    assert [row["crashed"] for row in rows()] == ["1"] * 4
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "exit"}))
    assert main(["sweep", "p.toml", "--out", "s", "--retry-failed"]) == 1
    assert [(row["harness_errors"], row["trials"]) for row in rows()] == [("1", "1")] * 4
    assert "The harness failed in 4 trials, which are in no count." in Path("s/sweep.md").read_text()


def test_a_wrong_plan_is_one_line_and_makes_no_folder(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for old, new, told in (
        ('"zero-action"', '"zero"', "plan p.toml: policies: no policy named 'zero' (did you mean 'zero-action'?)"),
        ('"zero-action"', '"zero-action"\narguments = { x = 1 }', "zero-action"),
        ("body", "bodies", "plan p.toml: axes.bodies: no such axis (did you mean 'body'?)"),
    ):
        Path("p.toml").write_text(PLAN.replace(old, new))
        assert main(["sweep", "p.toml", "--out", "s"]) == 2
        error = capsys.readouterr().err
        assert told in error
        assert not Path("s").exists()


def test_a_sweep_tells_its_table_as_json(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    Path("p.toml").write_text(
        PLAN.replace('body = ["man-adult", "woman-old-light"]', 'protocol = ["bathing-draft", "bathing-moved-draft"]')
    )
    assert main(["sweep", "p.toml", "--out", "s", "--json"]) == 0
    out = capsys.readouterr()
    (line,) = out.out.splitlines()
    answer = json.loads(line)
    assert (answer["schema"], answer["trials"], answer["planned"]) == ("carecontact-sweep-1", 8, 8)
    assert [rung["value"] for rung in answer["ladder"]["rungs"]] == ["bathing-draft", "bathing-moved-draft"]
    assert {climb["role"] for rung in answer["ladder"]["rungs"] for climb in rung["climbs"]} == {"blind"}
    assert "table: s/sweep.html" in out.err
    assert "Success over level" in Path("s/sweep.html").read_text()
