from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from carecontact.cli import progress as progress_of
from carecontact.cli.progress import progress
from carecontact.cli.run_bar import RunBar
from carecontact.cli.tally import Tally
from carecontact.recording import write_recording
from carecontact.recording.schema import EndReason
from carecontact.runs import score_run, write_scores
from carecontact.trials.scorer import Scorer
from carecontact.trials.supervisor import EventKind, TrialEvent
from tests.scoring.synthetic import make_recording, touch


def event(kind: EventKind, seed: int, *, ended: EndReason | None = None) -> TrialEvent:
    return TrialEvent(kind=kind, trial_id=f"T1-s{seed:03d}", done=seed + 1, total=10, ended=ended)


@pytest.fixture
def scorer() -> Iterator[Scorer]:
    with closing(Scorer(1, trials=1)) as scorer:
        yield scorer


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(touch(force=5.0, seed=0), tmp_path / "T1-s000.h5")
    write_recording(make_recording(seed=1), tmp_path / "T1-s001.h5")
    return tmp_path


def test_finished_trials_are_scored_once_and_counted(folder: Path, scorer: Scorer) -> None:
    tally = Tally(folder, scorer)
    assert tally.heartbeat().endswith(" s [0/0] 0 passed, 0 failed, 0 crashed, time left unknown")
    tally.take(event("started", 0))
    tally.take(event("finished", 0, ended="done"))
    tally.wait()
    assert " s [1/10] 1 passed, 0 failed, 0 crashed, last C1 5.0 N, about " in tally.heartbeat()

    tally = Tally(folder, scorer)
    tally.take(event("finished", 1, ended="done"))
    tally.take(event("finished", 2, ended="process_failure"))
    tally.take(event("finished", 3, ended="harness_error"))
    tally.take(event("finished", 4, ended="done"))
    tally.wait()
    assert tally.counts() == "0 passed, 1 failed, 1 crashed, 1 failed in the harness, last trial without contact", (
        "a recording that cannot be scored counts as neither"
    )


def test_kept_trials_count_by_their_stored_scores_and_take_no_time(folder: Path, scorer: Scorer) -> None:
    write_scores(folder, score_run(folder))
    tally = Tally(folder, scorer)
    tally.take(event("kept", 0, ended="done"))
    tally.take(event("kept", 1, ended="done"))
    tally.wait()
    assert tally.counts() == "1 passed, 1 failed, 0 crashed"
    assert tally.left() == "time left unknown"


def test_the_time_left_follows_the_trials_that_ran(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scorer: Scorer
) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    tally = Tally(tmp_path, scorer)
    tally.take(event("kept", 3, ended="process_failure"))
    steps = ((8, 4, "about 40 s left"), (600, 5, "about 20 min left"), (7200, 6, "about 2.0 h left"))
    for seconds, seed, told in steps:
        clock[0] = 100.0 + seconds
        tally.take(event("finished", seed, ended="process_failure"))
        assert tally.left() == told


LINE = "waiting for the policy: 40 of 120 s"


def silent(seed: int) -> TrialEvent:
    return TrialEvent(kind="waiting", trial_id=f"T1-s{seed:03d}", done=0, total=10, message=LINE)


def test_a_silent_policy_is_named_until_its_trial_ends(tmp_path: Path, scorer: Scorer) -> None:
    tally = Tally(tmp_path, scorer)
    tally.take(silent(0))
    assert tally.waiting() == [f"T1-s000 {LINE}"]
    tally.take(event("finished", 0, ended="process_failure"))
    assert tally.waiting() == []


def test_a_silent_policy_is_told_at_once_and_then_every_heartbeat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scorer: Scorer
) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with progress(tmp_path, scorer) as show:
        for seconds in (10, 20, 30, 40, 50, 80):
            clock[0] = 100.0 + seconds
            show(silent(0))
    told = [line.split(" [")[0].strip() for line in capsys.readouterr().out.splitlines() if LINE in line]
    assert told == ["10 s", "40 s", "80 s"], "between 50 s and 80 s it has answered, so its silence is a new one"


def test_a_heartbeat_comes_where_there_is_no_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scorer: Scorer
) -> None:
    monkeypatch.setattr(progress_of, "HEARTBEAT_S", 0.05)
    with progress(tmp_path, scorer) as show:
        show(event("finished", 0, ended="process_failure"))
        time.sleep(0.3)
    told = capsys.readouterr().out
    assert "0 s [1/10] T1-s000 crashed\n" in told
    assert "0 s [1/10] 0 passed, 0 failed, 1 crashed, about " in told
    time.sleep(0.1)
    assert capsys.readouterr().out == ""


def test_the_bar_shows_the_same_counts(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scorer: Scorer
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress(folder, scorer) as show:
        show(event("started", 2))
        show(event("finished", 2, ended="process_failure"))
        time.sleep(0.3)
    told = capsys.readouterr().out
    assert "1 crashed" in told
    assert "left" in told


def test_eighty_columns_show_counts_and_silent_policies_whole(tmp_path: Path, scorer: Scorer) -> None:
    tally = Tally(tmp_path, scorer)
    tally.passed, tally.failed, tally.crashed, tally.harness_failed = 100, 120, 130, 140
    for seed in range(12):
        tally.take(event("started", seed))
    for seed in range(6):
        tally.take(silent(seed))
    console = Console(width=80, file=StringIO(), force_terminal=True, color_system=None)
    bar = RunBar(tally, console=console)
    bar.advance_to(1, 140)
    console.print(bar.get_renderable())
    first, *lines = [line.rstrip() for line in console.file.getvalue().splitlines()]
    assert "1/140" in first
    assert "time left unknown" in first
    assert lines == [
        "100 passed, 120 failed, 130 crashed, 140 failed in the harness",
        *(f"T1-s00{seed} {LINE}" for seed in range(4)),
        "and 2 more wait for their policies",
        f"running: {' '.join(f'T1-s00{seed}' for seed in range(8))} T1-s00…",
    ]
