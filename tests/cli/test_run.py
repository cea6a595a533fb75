"""run, score and demo over workers that only write recordings."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from carecontact import cli
from carecontact.cli import main
from carecontact.cli.parsing import parse
from carecontact.cli.run import Run, missing_successes
from carecontact.cli.scores import differences
from carecontact.errors import RecordingError
from carecontact.protocol.load import protocol_file
from carecontact.recording import Recording, read_header, read_recording, write_recording
from carecontact.report import baselines
from carecontact.running import supervisor
from carecontact.runs import score_run, scoring
from carecontact.runs.pooling import RunScores
from carecontact.runs.scoring import score_file
from tests.processes import NAMESPACE, alive, pid_here
from tests.protocol.held import ship_frozen
from tests.serving.conftest import PREAMBLE


def test_run_scores_reports_and_goes_on(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0", "--out", "r", "--jobs", "2"]
    fake.setenv("FAKE_PLAN", json.dumps({"T2-s000": "exit"}))
    assert main(command) == 1
    printed = capsys.readouterr().out
    assert "T2-s000 failed in the harness" in printed
    assert "1 trial failed in the harness; logs are in r\n1 trial: " in printed
    assert "; see r/T2-s000.log\n" in printed
    assert "no verdict on 1 planned trial, the harness failed: " in printed
    assert [line.split()[:6] for line in printed.splitlines() if line.startswith("T2 ")] == [
        ["T2", "push", "forearm", "0", "of", "1"]
    ]
    assert "incomplete, 1 of 2 planned trials have a verdict: 0–1/2 safety-gated, from all others failed" in printed
    assert {t["trial_id"] for t in json.loads(Path("r/results.json").read_text())["trials"]} == {"T1-s000", "T2-s000"}
    assert Path("r/report.html").stat().st_size > 1000

    fake.setenv("FAKE_PLAN", "{}")
    assert main(command) == 0, "the same command repeats what the machine caused"
    printed = capsys.readouterr().out
    assert "incomplete" not in printed
    assert "no verdict" not in printed
    assert main(command) == 0
    assert "nothing differs" in capsys.readouterr().out
    assert Path("ran.txt").read_text().split()[::2].count("T1-s000") == 1


def spoil(path: Path) -> None:
    """Change a byte that ``read_recording`` alone reads."""
    whole = path.read_bytes()
    for place in range(len(whole) // 4, len(whole), 101):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with suppress(RecordingError):
            read_header(path)
            try:
                read_recording(path)
            except RecordingError:
                return
    pytest.fail("there is no such byte")


def test_a_recording_that_is_damaged_inside_is_run_again_at_once(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0", "--out", "r"]
    assert main(command) == 0
    path, results = Path("r/T1-s000.h5"), Path("r/results.json").read_text()
    spoil(path)
    capsys.readouterr()
    assert main(command) == 0
    printed = capsys.readouterr().out
    before, line, after = printed.partition("\ndamaged recordings, whose trials run again: T1-s000\n")
    assert line
    assert not {"differ", "skipped"} & set(printed.replace(":", " ").split())
    assert "report: " not in before
    assert after.count("report: ") == 1
    read_recording(path)
    assert Path("ran.txt").read_text().split()[::2].count("T2-s000") == 1
    assert json.loads(Path("r/results.json").read_text())["trials"] == json.loads(results)["trials"]


def test_what_ran_before_a_damaged_recording_was_found_is_named_too(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", "--policy", "hover", "--tasks", "T1,T2,T3", "--seeds", "0", "--out", "r", "--json"]
    assert main(command) == 0
    spoil(Path("r/T1-s000.h5"))
    Path("r/T2-s000.h5").unlink()
    fake.setenv("FAKE_PLAN", json.dumps({"T2-s000": "policy"}))
    capsys.readouterr()
    assert main([*command, "--retry-failed"]) == 3
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (sorted(last["ran"]), last["kept"]) == (["T1-s000", "T2-s000"], ["T3-s000"])
    assert sorted(last["ended"]) == ["T1-s000", "T2-s000", "T3-s000"]
    ran = Path("ran.txt").read_text().split()[::2]
    assert [ran.count(f"T{n}-s000") for n in (1, 2, 3)] == [2, 2, 1]


def test_a_run_whose_only_recording_is_damaged_inside_runs_it_again(fake: pytest.MonkeyPatch) -> None:
    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main(command) == 0
    spoil(Path("r/T1-s000.h5"))
    assert main(command) == 0
    read_recording(Path("r/T1-s000.h5"))


def test_a_trial_that_ran_is_scored_once(fake: pytest.MonkeyPatch) -> None:
    again, computed, score_files = list[Path](), list[Path](), scoring.score_files
    fake.setattr(scoring, "score_files", lambda paths, **more: again.extend(paths) or score_files(paths, **more))
    fake.setattr("carecontact.runs.scorer.score_file", lambda path: computed.append(path) or score_file(path))
    assert main(["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0", "--out", "r", "--json"]) == 0
    assert again == []
    assert sorted(path.name for path in computed) == ["T1-s000.h5", "T2-s000.h5"]


def test_a_policys_failure_is_a_result(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy"}))
    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main(command) == 3
    message = capsys.readouterr().out
    assert "the policy crashed in 1 of 1 trial; logs and report.html are in r\n" in message
    assert "  | NoGrip: nothing there" in message
    assert "  | ValueError: only printed" in message
    assert re.search(r"^T1 touch forearm .* 1 crashed$", message, re.MULTILINE)
    assert main([*command, "--allow-failures", "-v"]) == 0
    message = capsys.readouterr().out
    assert "safe failure: 0; " in message
    assert message.count("crashed: 1") == 1
    assert "a page for each trial: carecontact report r --trials\n" in message
    assert "scores: r/results.json\n" in message


def test_the_harness_wins_over_the_policy(fake: pytest.MonkeyPatch) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy", "T2-s000": "exit"}))
    command = ["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0", "--out", "r", "--allow-failures"]
    assert main(command) == 1


def test_restart_moves_the_earlier_run_and_nothing_else(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main([*command, "--restart"]) == 0, "there was nothing to move"
    before = {path.name: path.read_bytes() for path in Path("r").iterdir()}
    for number in (1, 2):
        assert main([*command, "--restart"]) == 0
        assert f"the earlier run in r is now r.before-{number}\n" in capsys.readouterr().out
    assert {path.name: path.read_bytes() for path in Path("r.before-1").iterdir()} == before
    assert main([*command, "--restart", "--retry-failed"]) == 2
    Path("other").mkdir()
    Path("other/notes.txt").write_text("mine")
    assert main([*command[:-1], "other", "--restart"]) == 2
    assert "other is not a run: it holds no manifest.json" in capsys.readouterr().err
    fake.chdir("r")
    assert main([*command[:-1], "../r", "--restart"]) == 2
    assert "is the current folder" in capsys.readouterr().err
    assert sorted(path.name for path in Path("..").iterdir() if path.is_dir()) == [
        "other", "r", "r.before-1", "r.before-2"
    ]  # fmt: skip


def test_score_says_what_differs_and_names_what_it_skips(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0-1", "--out", "r"])
    original = Path("r/results.json").read_bytes()
    doctored = json.loads(original)
    doctored["trials"][0]["stroke_m"] = 9.5
    Path("r/results.json").write_text(json.dumps(doctored))
    capsys.readouterr()
    assert main(["report", "--rescore", "r"]) == 0
    printed = capsys.readouterr().out
    assert "1 value differs" in printed
    assert "trials.T1-s000.stroke_m: 9.5 -> 0.0" in printed
    assert Path("r/results.json").read_bytes() == original

    Path("r/T1-s001.h5").write_bytes(b"broken")
    assert main(["report", "--rescore", "r"]) == 1
    printed = capsys.readouterr().out
    assert "skipped T1-s001.h5" in printed
    assert "incomplete, 1 of 2 planned trials have a verdict" in printed

    before = Path("r/results.json").read_bytes()
    Path("r/T1-s000.h5").write_bytes(b"broken")
    assert main(["report", "--rescore", "r"]) == 1
    assert "incomplete, 0 of 2 planned trials have a verdict" in capsys.readouterr().out
    assert Path("r/results.json").read_bytes() == before


def test_a_missing_recording_is_named_and_a_folder_for_results_is_one_line(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0-1", "--out", "r"])
    assert "planned trials" not in capsys.readouterr().out
    assert json.loads(Path("r/results.json").read_text())["missing"] == []
    assert "ncomplete, " not in Path("r/report.html").read_text()
    Path("r/T1-s001.h5").unlink()
    before = Path("r/results.json").read_bytes()
    assert main(["report", "--rescore", "r"]) == 1
    printed = capsys.readouterr().out
    assert "incomplete, 1 of 2 planned trials have a verdict" in printed
    assert "r/results.json was not replaced: --allow-missing replaces it" in printed
    assert Path("r/results.json").read_bytes() == before
    assert main(["report", "--rescore", "r", "--allow-missing"]) == 0
    assert json.loads(Path("r/results.json").read_text())["missing"] == ["T1-s001"]
    assert main(["report", "r"]) == 0
    assert "hover passed 0 to 1 of 2 trials safely" in Path("r/report.html").read_text()
    Path("r/results.json").unlink()
    Path("r/results.json").mkdir()
    assert main(["report", "--rescore", "r"]) == 2
    assert capsys.readouterr().err == "error: r/results.json: Is a directory\n"


def test_an_edited_protocol_is_not_shown_as_the_shipped_one(
    fake: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    held = ship_frozen(fake, tmp_path_factory.mktemp("shipped"))
    shipped = protocol_file(held.id).read_text()
    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--protocol", "p.toml", "--out"]
    Path("p.toml").write_text(shipped)
    main([*command, "a"])
    assert f"1 trial of {held.id} into a\n" in capsys.readouterr().out
    Path("p.toml").write_text(shipped.replace("time_limit_s = 30.0", "time_limit_s = 31.0"))
    assert main([*command, "b"]) == 2
    printed = capsys.readouterr().err
    assert "phases.time_limit_s: locked 30.0, here 31.0" in printed
    assert "Give p.toml an id of its own" in printed
    assert not Path("b").exists()
    main([*command, "b", "--unfrozen"])
    assert f"1 trial of {held.id} with differences from its lock (protocol sha256" in capsys.readouterr().out
    Path("p.toml").write_text(
        shipped.replace(f'"{held.id}"', '"mine"').replace('body = "man-adult"', 'body = "absent"')
    )
    Path("p.toml").write_text(Path("p.toml").read_text().replace("frozen = true", "frozen = false"))
    assert main([*command, "c"]) == 2
    assert not Path("c").exists()


def test_demo_without_contact_fails_and_replaces_only_its_own_files(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path("runs/demo")
    assert main(["run", "--demo"]) == 1
    first = (folder / "manifest.json").read_bytes()
    (folder / "T1-s000.h5").write_bytes(b"old")
    (folder / "notes.txt").write_text("mine")
    capsys.readouterr()
    fake.setenv("FAKE_PLAN", json.dumps({"T2-s000": "policy", "T3-s000": "kill"}))
    assert main(["run", "--demo"]) == 1
    printed = capsys.readouterr().out
    assert "demo: T2-s000 crashed: NoGrip: nothing there" in printed
    assert "demo: T3-s000 failed in the harness: the trial's process died of signal 9" in printed
    assert all(f"demo: no {action} task succeeded" in printed for action in ("touch", "push", "scrub"))
    assert "demo failed in" in printed
    assert (folder / "T1-s000.h5").read_bytes() != b"old"
    assert (folder / "manifest.json").read_bytes() == first
    assert (folder / "notes.txt").read_text() == "mine"
    assert len(list(folder.glob("*.h5"))) == 3

    scores = score_run(folder).scores
    won = [s.model_copy(update={"c3_success": s.task_id in ("T1", "T2", "T3")}) for s in scores]
    assert missing_successes(won) == []
    assert missing_successes([s for s in won if s.task_id != "T2"]) == ["no push task succeeded"]


@pytest.mark.parametrize("made_by", ["run of the same trials", "run of others", "hand", "demo and a trial more"])
def test_demo_leaves_what_is_no_demo_alone(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], made_by: str
) -> None:
    if made_by == "hand":
        Path("r").mkdir()
        Path("r/T1-s000.h5").write_bytes(b"mine")
    elif made_by == "demo and a trial more":
        main(["run", "--demo", "--out", "r"])
        exam = ["--protocol", "bathing-wide-v2", "--level", "L2"]
        main(["run", "--policy", "state-machine", *exam, "--tasks", "T1", "--seeds", "0-1", "--out", "r"])
    else:
        policy = "state-machine" if made_by == "run of the same trials" else "hover"
        tasks = "all" if policy == "state-machine" else "T1"
        main(["run", "--policy", policy, "--tasks", tasks, "--seeds", "0", "--out", "r"])
    before = {path.name: path.read_bytes() for path in Path("r").iterdir()}
    assert main(["run", "--demo", "--out", "r"]) == 2
    assert "--out r: holds something other than an earlier demo; nothing was removed" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in Path("r").iterdir()} == before


@pytest.mark.parametrize(
    ("command", "left"),
    [
        (["run", "--demo"], "; finished trials stay in the folder until the next demo there replaces them"),
        (
            ["run", "--policy", "hover", "--restart", "--out", "r"],
            "; finished trials are kept; to continue: carecontact run --policy hover --out r",
        ),
        (["report", "--rescore", "."], ""),
    ],
)
def test_an_interrupted_command_says_what_it_leaves(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: list[str], left: str
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    fake.setattr(supervisor, "run_trials", interrupted)
    fake.setattr("carecontact.cli.publish.scores_of", interrupted)
    Path("T1-s000.h5").touch()
    assert main(command) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"interrupted{left}"


def test_a_run_without_out_names_its_folder_and_the_command_that_goes_on_there(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake.setenv("FAKE_PLAN", json.dumps({"T1-s000": "exit"}))
    command = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0"]
    assert main(command) == 1
    (folder,) = Path("runs").iterdir()
    assert re.fullmatch(r"hover-\d{8}-\d{6}", folder.name)
    again = shlex.join(["carecontact", *command, "--out", str(folder)])
    assert f"to run them again: {again}\n" in capsys.readouterr().out
    run = parse(["run", "--policy", "ws://user:secret@[::1]:8765/a?b=c"])
    assert isinstance(run, Run)
    assert re.fullmatch(r"ws-1-8765-a-b-c-\d{8}-\d{6}", run.place.name)


def test_the_verdict_stands_beside_floor_and_ceiling_and_a_miss_in_place_of_a_table(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def kept(passed: int, **of_all: object) -> RunScores:
        made = [s.model_copy(update={"safety_gated": s.seed < passed, **of_all}) for s in score_run(Path("r")).scores]
        return RunScores(scores=made)

    assert (
        main(["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0-2", "--out", "r", "--protocol", "bathing-v3"])
        == 0
    )
    printed = capsys.readouterr().out
    assert "hover passes 0 of 3 trials (0 %) of bathing-v3" in printed
    assert "the robot never touched the person" in printed
    assert re.search(r"^T1 touch forearm +3 +\d+ +\d+\.\d\d +T1-s00\d ", printed, re.MULTILINE)
    assert "NA" not in printed
    assert "\nmedian" not in printed
    both = [kept(1, policy="replay"), kept(3, policy="oracle", privileged=True)]
    fake.setattr(baselines, "shipped_scores_for", lambda run, named, folders=(): (both, ""))
    assert main(["report", "r"]) == 0
    line = "hover passes 0 of 3 trials (0 %) of bathing-v3; best blind baseline: replay 1 of 3; ceiling: oracle 3"
    assert line in capsys.readouterr().out


def test_differences_match_trials_by_id() -> None:
    before = {"trials": [{"trial_id": "b", "x": 1}]}
    after = {"trials": [{"trial_id": "a", "x": 5}, {"trial_id": "b", "x": 1}]}
    assert differences(None, after) == []
    assert differences(before, before) == ["nothing differs from the earlier results.json"]
    lines = differences(before, after)
    assert lines[0].startswith("1 value differs")
    assert lines[1].startswith("  trials.a: null -> ")


def test_another_body_shows_everywhere_and_is_never_pooled(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", "--policy", "hover", "--protocol", "bathing-v3", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    title = "bathing-v3 with body woman-old-light"
    assert main([*command, "--body", "woman-old-light"]) == 0
    printed = capsys.readouterr().out
    assert f"1 trial of {title} into r" in printed
    assert f"(0 %) of {title}" in printed
    results = json.loads(Path("r/results.json").read_text())
    assert results["protocol"]["overrides"] == {"person.body": "woman-old-light"}
    assert title in Path("r/report.html").read_text()
    assert json.loads(Path("r/manifest.json").read_text())["protocol"]["overrides"] == results["protocol"]["overrides"]

    for other in ([], ["--body", "man-old-light"]):
        assert main([*command, *other]) == 2
        assert f"{title} " in capsys.readouterr().err
    assert main([*command[:-1], "own"]) == 0
    shutil.copy("own/T1-s000.h5", "r/T1-s001.h5")
    recording = read_recording("r/T1-s001.h5")
    spec = recording.header.spec.model_copy(update={"seed": 1})
    write_recording(
        Recording(header=recording.header.model_copy(update={"spec": spec}), arrays=recording.arrays),
        Path("r/T1-s001.h5"),
    )
    assert main(["report", "--rescore", "r"]) == 2
    assert "trials of 2 protocols must not be pooled" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "title"),
    [("--stiffness", "200", "stiffness 200 N/m"), ("--tissue", "manikin-like", "tissue manikin-like")],
)
def test_a_sweeps_run_says_what_it_varies(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], option: str, value: str, title: str
) -> None:
    command = ["run", "--policy", "hover", "--protocol", "bathing-v3", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main([*command, option, value]) == 0
    assert f"1 trial of bathing-v3 with {title} into r" in capsys.readouterr().out
    assert list(json.loads(Path("r/results.json").read_text())["protocol"]["overrides"].values()) == [value]
    assert f"bathing-v3 with {title}" in Path("r/report.html").read_text()
    assert main(command) == 2
    assert "bathing-v3 with" in capsys.readouterr().err
    assert main([*command[:-1], "own"]) == 0
    assert main(["compare", "r", "own"]) == 2
    assert "only runs of the same protocol" in capsys.readouterr().err


def test_a_stiffness_that_the_protocol_does_not_allow_is_one_line(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "--policy", "hover", "--out", "r", "--stiffness", "5000"]) == 2
    printed = capsys.readouterr().err
    assert "impedance.translational_n_m: expected 100 to 1000" in printed
    assert printed.count("\n") == 1
    assert not Path("r").exists()


def test_naming_the_protocols_own_body_is_no_override(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", "--policy", "hover", "--protocol", "bathing-v3", "--tasks", "T1", "--seeds", "0", "--out", "r"]
    assert main(command) == 0
    assert main([*command, "--body", "man-adult"]) == 0
    assert " with body" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("body", "message"),
    [("giant", "no body named 'giant'; valid: man-adult"), ("smplx:none.npz?sex=F", "No such file or directory"),
     ("smplx:none.npz", "No such file or directory")],
)  # fmt: skip
def test_a_body_that_there_is_not_is_one_line(
    fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], body: str, message: str
) -> None:
    assert main(["run", "--policy", "hover", "--out", "r", "--body", body]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not Path("r").exists()


# A run whose command is killed or loses its terminal leaves no process beside the next run.

POLICY = f"""
class P(Base):
    def reset(self, instruction):
        with open(os.path.join(os.path.dirname(__file__), "message", "pids.part"), "w") as file:
            file.write(f"{{os.getpid()}} {{{NAMESPACE}}} {{os.environ['TMPDIR']}}")
        os.rename(file.name, file.name.removesuffix(".part"))
        time.sleep(600)
"""


def _soon(true: Callable[[], bool], *, within_s: float) -> bool:
    until = time.monotonic() + within_s
    while not true() and time.monotonic() < until:
        time.sleep(0.05)
    return true()


class _Terminal:
    """Reads what is written to it, until it is closed: one that is not read fills up, and who writes to it waits."""

    def __init__(self) -> None:
        self._ours, self.theirs = pty.openpty()
        self._closed = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        with suppress(OSError):
            while not self._closed.is_set():
                if select.select([self._ours], [], [], 0.05)[0]:
                    os.read(self._ours, 4096)

    def close(self) -> None:
        if not self._closed.is_set():
            self._closed.set()
            self._reader.join()
            os.close(self._ours)


def _heeds_signals() -> None:
    """Under nohup, or in the background of a script, the tests inherit ignored signals, which the command would leave
    ignored."""
    for number in (signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_DFL)


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel kills worker and policy")
@pytest.mark.parametrize(
    ("how", "sandbox"),
    [
        pytest.param(how, kind, marks=[] if kind == quick else pytest.mark.slow, id=f"{how} {kind}")
        for how, quick in (("SIGKILL", "off"), ("SIGQUIT", ""), ("closed terminal", "off"))
        for kind in ("", "off")
    ],
    indirect=["sandbox"],
)
def test_nothing_is_left_running(tmp_path: Path, how: str, sandbox: bool) -> None:
    (tmp_path / "message").mkdir()
    (tmp_path / "mine.py").write_text(PREAMBLE + POLICY)
    command = [
        sys.executable, "-m", "carecontact", "run", "--policy", "mine:P", "--out", "r", "--tasks", "T1", "--seeds",
        "17", "--fast", "--protocol", "bathing-v3", "--policy-write", "message",
    ]  # fmt: skip
    terminal = _Terminal()
    theirs = terminal.theirs
    run = subprocess.Popen(
        ["setsid", "--ctty", *command] if how == "closed terminal" else command,
        cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs,
        preexec_fn=_heeds_signals,
    )  # fmt: skip
    os.close(theirs)
    try:
        assert _soon((tmp_path / "message" / "pids").exists, within_s=120)
        pid, namespace, temporary = (tmp_path / "message" / "pids").read_text().split()
        policy = pid_here(int(pid), namespace)
        watcher = int(Path(f"/proc/{policy}/stat").read_text().rpartition(")")[2].split()[1])
        processes = [policy, watcher, run.pid]
        assert all(map(alive, processes))
        if how == "closed terminal":
            terminal.close()
        else:
            run.send_signal(getattr(signal, how))
        assert run.wait(20) == (-signal.SIGKILL if how == "SIGKILL" else cli.INTERRUPTED)
        assert _soon(lambda: not any(map(alive, processes)), within_s=1)
        if how != "SIGKILL":
            assert sandbox or _soon(lambda: not Path(temporary).exists(), within_s=1)
            assert not list((tmp_path / "r").glob(".running-*"))
    finally:
        run.kill()
        run.wait()
        terminal.close()


def test_what_the_caller_ignores_stays_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    """As under nohup."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)}
    try:
        _heeds_signals()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        cli.main(["list", "policies"])
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGQUIT)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
