from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

import carecontact
from carecontact.cli import main
from carecontact.cli import progress as progress_of
from carecontact.cli.progress import RunBar, Tally, progress
from carecontact.recording import write_recording
from carecontact.recording.schema import EndReason
from carecontact.running.supervisor import EventKind, TrialEvent
from carecontact.runs import score_run, write_scores
from carecontact.runs.scorer import Scorer
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
    for seconds, seed, message in steps:
        clock[0] = 100.0 + seconds
        tally.take(event("finished", seed, ended="process_failure"))
        assert tally.left() == message


LINE = "waiting for the policy: 40 of 120 s"


def silent(seed: int) -> TrialEvent:
    return TrialEvent(kind="waiting", trial_id=f"T1-s{seed:03d}", done=0, total=10, message=LINE)


def test_a_silent_policy_is_named_until_its_trial_ends(tmp_path: Path, scorer: Scorer) -> None:
    tally = Tally(tmp_path, scorer)
    tally.take(silent(0))
    assert tally.waiting() == [f"T1-s000 {LINE}"]
    tally.take(event("finished", 0, ended="process_failure"))
    assert tally.waiting() == []


def test_a_silent_policy_is_named_at_once_and_then_every_heartbeat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scorer: Scorer
) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with progress(tmp_path, scorer) as show:
        for seconds in (10, 20, 30, 40, 50, 80):
            clock[0] = 100.0 + seconds
            show(silent(0))
    printed = [line.split(" [")[0].strip() for line in capsys.readouterr().out.splitlines() if LINE in line]
    assert printed == ["10 s", "40 s", "80 s"], "between 50 s and 80 s it has answered, so its silence is a new one"


def test_a_heartbeat_comes_where_there_is_no_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scorer: Scorer
) -> None:
    monkeypatch.setattr(progress_of, "HEARTBEAT_S", 0.05)
    with progress(tmp_path, scorer) as show:
        show(event("finished", 0, ended="process_failure"))
        time.sleep(0.3)
    printed = capsys.readouterr().out
    assert "0 s [1/10] T1-s000 crashed\n" in printed
    assert "0 s [1/10] 0 passed, 0 failed, 1 crashed, about " in printed
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
    printed = capsys.readouterr().out
    assert "1 crashed" in printed
    assert "left" in printed


def test_eighty_columns_show_counts_and_silent_policies_whole(tmp_path: Path, scorer: Scorer) -> None:
    tally = Tally(tmp_path, scorer)
    tally.passed, tally.failed, tally.crashed, tally.harness_failed = 100, 120, 130, 140
    for seed in range(12):
        tally.take(event("started", seed))
    for seed in range(6):
        tally.take(silent(seed))
    console = Console(width=80, file=StringIO(), force_terminal=True, color_system=None)
    bar = RunBar(tally, console=console)
    bar.show(replace(event("started", 0), total=140))
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


# A policy that crashes, hangs, is killed or answers NaN, through real trials: status, headline, traceback.

SOURCES = str(Path(carecontact.__file__).parents[1])
POLICY = """
import os, signal, time
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Faulty:
    card = PolicyCard(name="faulty", modalities=("rgb",), cameras=("wrist",))
    def reset(self, instruction): print("these were", "its last words", flush=True)
    def act(self, observation):
        {act}
"""
FAULTS = {
    "crashing": ("raise ValueError('no grip here')", "ValueError: no grip here", 'my.py", line 11, in act'),
    "hanging": ("time.sleep(600)", "no actions message within 4 s", 'my.py", line 11, in act'),
    "killed": ("os.kill(os.getpid(), signal.SIGKILL)", "its process was killed by SIGKILL", ""),
    "NaN": ("return [Action(pose_tcp_in_base=np.full(7, np.nan))]", "nan", ""),
}
HINT = "Look for a division by 0 or an unset value in the policy&#39;s output."


@pytest.mark.parametrize(
    "fault", [pytest.param(fault, marks=[pytest.mark.slow] * (fault in ("hanging", "killed"))) for fault in FAULTS]
)
def test_a_policy_that_fails_ends_with_status_3_and_its_traceback(tmp_path: Path, fault: str) -> None:
    act, message, place = FAULTS[fault]
    (tmp_path / "my.py").write_text(POLICY.replace("{act}", act))
    done = subprocess.run(
        [
            sys.executable, "-m", "carecontact", "run", "--policy", "my:Faulty", "--tasks", "T1", "--seeds", "0",
            "--out", "r", "--fast", "--protocol", "bathing-v3", "--set", "phases.first_call_deadline_s=4",
        ],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": SOURCES}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert "the policy crashed in 1 of 1 trial; logs and report.html are in r" in done.stdout
    assert re.search(rf"^1 trial: .*{message}.*; see r/T1-s000.log$", done.stdout, re.MULTILINE)
    assert place in done.stdout
    assert "  | these were its last words" in done.stdout
    assert ("  hint: Look for a division by 0" in done.stdout) == (fault == "NaN")
    assert re.search(r"^T1 touch forearm .* 1 crashed$", done.stdout, re.MULTILINE)
    page = (tmp_path / "r" / "report.html").read_text()
    assert "The policy crashed in 1 of 1 trial" in page
    label = {"crashing": "Traceback", "hanging": "Stack"}.get(fault)
    label = f"{label} and last output" if label else "Last output"
    assert f"<summary>{label} of T1-s000</summary>" in page
    (shown,) = re.findall(r"<details>.*?<pre>(.*?)</pre></details>", page, re.DOTALL)
    assert message in shown
    assert place.replace('"', "&#34;") in shown
    assert (HINT in page) == (fault == "NaN")
    assert "these were its last words" in shown
    assert ("Traceback" in shown) == (fault == "crashing")


STARTS = {
    "missing import": (
        "import no_such_library",
        "ModuleNotFoundError: No module named 'no_such_library'",
        ['  |   File "{}/my.py", line 2, in <module>', "  |     import no_such_library"],
    ),
    "crash in __init__": (
        "class Faulty:\n    def __init__(self):\n        print('loading')\n        {}['weights']",
        "KeyError: 'weights'",
        ["  |     {}['weights']", "  | it printed last:", "  | loading"],
    ),
    "sys.exit": (
        "import sys\nprint('nothing to do')\nsys.exit(0)",
        "SystemExit: 0",
        ["  |     sys.exit(0)", "  | nothing to do"],
    ),
    "another name": (
        "class Fault: ...",
        "ImportError: my has no 'Faulty'; it has no class with act (did you mean my:Fault?)",
        [],
    ),
    "quiet end": (
        "import os\nprint('bye', flush=True)\nos._exit(0)",
        "its process ended itself with exit code 0 before it was ready",
        ["  | it printed last:", "  | bye"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("start", STARTS)
def test_a_policy_that_does_not_start_ends_with_status_2_and_its_traceback(
    tmp_path: Path, start: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, why, lines = STARTS[start]
    (tmp_path / "my.py").write_text(f"\n{source}\n")
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--policy", "my:Faulty", "--tasks", "T1", "--seeds", "0", "--out", "r"]) == 2
    first, *more = capsys.readouterr().err.splitlines()
    assert first == (
        f"error: --policy my:Faulty does not start (looked in {tmp_path} first): {why}; `carecontact check` shows all "
        "of it"
    )
    place = str(tmp_path)
    assert [line for line in lines if line.replace("{}/", f"{place}/") not in more] == []
    assert bool(more) == bool(lines)
    assert not [line for line in more if "File" in line and place not in line]
    assert not Path("r").exists()


def test_equal_failures_stand_together_with_up_to_three_logs(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = {f"T1-s00{seed}": "policy" for seed in range(4)}
    fake.setenv("FAKE_PLAN", json.dumps({**policy, "T1-s004": "lost", "T2-s000": "exit", "T2-s001": "exit"}))
    assert main(["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0-4", "--out", "r"]) == 1
    printed = capsys.readouterr().out
    logs = "r/T1-s000.log, r/T1-s001.log, r/T1-s002.log and 1 more"
    assert "the policy crashed in 5 of 10 trials; logs and report.html are in r\n4 trials: " in printed
    assert f"\n4 trials: NoGrip: nothing there; see {logs}\n  | " in printed
    assert re.search(r"\n1 trial: the trial's process died of signal 9 .*; see r/T1-s004.log\n", printed)
    assert "2 trials failed in the harness; logs are in r\n2 trials: the trial's process ended with status 7" in printed
    assert "; see r/T2-s000.log, r/T2-s001.log\nto run them again: carecontact run --policy hover " in printed


XYZW = """
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Suspect:
    card = PolicyCard(name="suspect", out_of_bounds="clip")
    def reset(self, instruction): ...
    def act(self, observation):
        pose = observation.pose_tcp_in_base
        outside = np.array([5.0, *pose[1:]])
        return [
            Action(pose_tcp_in_base=np.array([*pose[:3], *np.roll(pose[3:], -1)])),
            Action(pose_tcp_in_base=outside), Action(done=True),
        ]
"""


def test_what_is_suspect_about_the_first_answer_and_what_was_clipped_is_named_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my.py").write_text(XYZW)
    monkeypatch.chdir(tmp_path)
    run = ["run", "--policy", "my:Suspect", "--tasks", "T1", "--seeds", "0-1", "--out", "r", "--fast", "--jobs", "1"]
    run += ["--protocol", "bathing-v3"]
    assert main(run) == 0
    printed = capsys.readouterr().out
    first, clipped = (line for line in printed.splitlines() if line.startswith("warning: "))
    assert first.startswith("warning: the first answer of T1-s000, quaternion: the first target turns the tool by ")
    assert first.endswith("send quaternions in the order w x y z")
    assert printed.index(first) < printed.index("T1-s001 done"), "before the run is over"
    assert clipped.startswith("warning: In 2 of 2 trials the benchmark moved targets outside the workspace onto its ")
    assert "(2 actions in all)" in clipped
