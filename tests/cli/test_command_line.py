"""The command as a user types it: what is wrong is one line, without a traceback."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

import carecontact as carecontact_package
from carecontact import __version__
from carecontact.cli import main
from carecontact.cli.publish import publish, scores_of
from carecontact.interface.regions import JOINTS, LIMB_PARTS, SEGMENTS
from carecontact.recording import write_recording
from carecontact.scoring import METRICS
from carecontact.scoring.limits import LIMIT_PACKS
from tests.scoring.synthetic import touch

SOURCES = str(Path(carecontact_package.__file__).parents[1])
BROKEN = "class Broken:\n    def __init__(self):\n        raise RuntimeError('no weights here')\n"


def carecontact(*arguments: str, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "carecontact", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": SOURCES, **variables},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "--policy", "absent", "--out", "r"], "no policy named 'absent'; valid: feint-and-wait, hover"),
        (["run", "--policy", "no_such:Thing", "--out", "r"], "No module named 'no_such'"),
        (["run", "--policy", "a b:C", "--out", "r"], "expected module:Class"),
        (["run", "--policy", "hover", "--out", "r", "--tasks", "T9"], "valid: T1, T2, T3, T4, T5, T6, T7"),
        (["run", "--policy", "hover", "--out", "r", "--seeds", "54"], "valid: 0-53, 1000-1053"),
        (
            ["run", "--policy", "hover", "--out", "r", "--protocol", "p"],
            "no protocol named 'p'; valid: bathing-droid-v1, bathing-v3, bathing-wide-v2",
        ),
        (["run", "--policy", "hover", "--out", "r", "--jobs", "0"], "must be at least 1"),
        (["run", "--policy", "hover", "--out", "broken.py"], "this is a file"),
        (["run", "--policy", "hover", "--out", "broken.py/r"], "broken.py/r: cannot be written to: Not a directory"),
        (["run", "--policy", "hover", "--out", "r", "--jobs", "two"], "--jobs: expected INT, got 'two'"),
        (["run", "--out", "r"], "run: name a policy with --policy (`carecontact list policies`), or give --demo"),
        (["sweep"], "Missing from carecontact sweep: PLAN.toml; For full helptext"),
        (
            ["run", "--demo", "--seeds", "1"],
            "--seeds does not go with --demo, which takes only --out, --jobs, --verbose, --video",
        ),
        (["score", "r"], "`carecontact score` is now `carecontact report --rescore`"),
        (
            ["export", "lerobot-v2.1", "r"],
            "`carecontact export lerobot-v2.1` is now `carecontact export lerobot --form",
        ),
        (
            ["verify", "physic"],
            "carecontact verify has no command 'physic' (did you mean 'physics'?); valid: physics, ",
        ),
        (["report", "r", "--append"], "--append belongs to `carecontact report --rescore`"),
        (["view", "r.h5", "--camera", "wrist"], "view: --camera belongs to `carecontact view --video`"),
        (["view", "--start", "r.h5"], "view --start: TRIAL.h5 belongs to `carecontact view` or "),
        (["view", "--video", "--notes", "r.h5"], "--video and --notes exclude each other"),
        (["view", "--video"], "view: name the recording of a trial (TRIAL.h5), or give --start"),
        (["run", "--polixy", "hover", "--out", "r"], "run has no option --polixy (did you mean '--policy'?); "),
        (["verify", "physics", "--body", "man-adult", "--body", "woman-old-light"], "--body is given twice"),
        (
            ["view", "--start", "--task", "T9"],
            "'T9' is not a task of bathing-wide-v2; valid: T1, T2, T3, T4, T5, T6, T7",
        ),
        (["view", "--start", "--seed", "54"], "--seed: 54 is not a seed of bathing-wide-v2; valid: 0-53, 1000-1053"),
        (["view", "--start", "--out", "r"], "a picture ends in .png, .jpg, .pdf"),
        (["view", "--start", "--body", "absent"], "no body named 'absent'"),
        (["view", "--start", "--set", "physics.dt_s=0.004", "--set", "physics.dt_m=1"], "physics.dt_m"),
        (["list", "foo"], "no choice named 'foo'; valid: tasks, "),
        (["run", "--demo", "--out", "."], "--out .: holds something other than an earlier demo; nothing was removed"),
        (["report", "--rescore", "nowhere"], "nowhere: no such folder"),
        (["report", "."], "holds no recordings"),
    ],
)
def test_errors_are_one_line_and_change_nothing(
    tmp_path: Path,
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.py").write_text(BROKEN)
    assert main(arguments) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert message in printed
    assert printed.count("\n") == 1
    assert not Path("r").exists()


def test_no_command_shows_the_help() -> None:
    with pytest.raises(SystemExit) as caught:
        main([])
    assert caught.value.code == 0


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"carecontact {__version__}\n"


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("tasks", ["T1", "T2", "T3", "T4", "T5", "T6", "T7"]),
        (
            "protocols",
            [
                *4 * ["bathing-droid-v1"],
                "bathing-v3",
                *4 * ["bathing-wide-v2"],
            ],
        ),
        ("metrics", sorted(METRICS)),
        ("limits", sorted(LIMIT_PACKS)),
        ("segments", [*SEGMENTS, *LIMB_PARTS, *JOINTS]),
    ],
)
def test_list(what: str, expected: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", what]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == expected


@pytest.mark.parametrize(("what", "some"), [("policies", "state-machine"), ("bodies", "man-adult")])
def test_list_of_what_grows(what: str, some: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", what]) == 0
    assert some in [line.split()[0] for line in capsys.readouterr().out.splitlines()]


def test_listed_bodies_say_who_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "bodies"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert len(rows) == 10
    for message in ("woman", "old", "1.57 m", "50.5 kg", "BMI 20.5", "Apache-2.0"):
        assert message in rows["woman-old-light"]
    assert "docs/person.md" in rows["smplx:FILE.npz?sex=F"]


def test_nothing_is_printed_before_jobs_is_checked(tmp_path: Path) -> None:
    for command in (["run", "--policy", "hover", "--out", "r"], ["run", "--demo", "--out", "r"]):
        assert carecontact(*command, "--jobs", "0", cwd=tmp_path).stdout == ""


def test_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "carecontact", "list"],
        env={**os.environ, "PYTHONPATH": SOURCES},
        stdout=writing,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("option", [[], ["--json"]])
def test_standard_output_without_space(option: list[str]) -> None:
    command = [sys.executable, "-m", "carecontact", "list", "policies", *option]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("error: standard output or a file: No space left on device; free some space there")
    assert "Traceback" not in done.stderr


def test_a_run_without_standard_output(tmp_path: Path) -> None:
    command = (
        f"{sys.executable} -m carecontact run --policy zero-action --protocol bathing-v3 --tasks T1 --seeds 0 --out r"
    )
    done = subprocess.run(
        ["sh", "-c", f"{command} --set phases.time_limit_s=1 >&- 2>&-"],
        env={**os.environ, "PYTHONPATH": SOURCES}, cwd=tmp_path, capture_output=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "r" / "report.html").stat().st_size > 1000


def test_a_run_whose_reader_goes_away_is_no_other_run(tmp_path: Path) -> None:
    command = [
        "run",
        "--policy",
        "zero-action",
        "--protocol",
        "bathing-v3",
        "--tasks",
        "T1",
        "--seeds",
        "0-1",
        "--out",
        "r",
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "carecontact", *command, "--set", "phases.time_limit_s=1"],
        env={**os.environ, "PYTHONPATH": SOURCES},
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        assert running.stdout.readline().startswith(b"zero-action: 2 trials")
        running.stdout.close()
        assert (running.wait(60), running.stderr.read()) == (0, b"")
    made = {path.name for path in (tmp_path / "r").iterdir()} - {"results.parquet"}
    assert made == {"T1-s000.h5", "T1-s001.h5", "manifest.json", "report.html", "results.json"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_every_file_is_written_before_a_table_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recording(touch(), tmp_path / "T1-s000.h5")
    with open("/dev/full", "w", buffering=1) as full:
        monkeypatch.setattr(sys, "stdout", full)
        with pytest.raises(OSError, match="No space left on device"):
            publish(tmp_path, scores_of(tmp_path))
        monkeypatch.undo()
        with suppress(OSError):
            full.close()
    assert {"results.json", "report.html"} < {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize("command", [["verify", "physics"], ["verify", "leaks", "--quick"]])
def test_a_command_that_runs_no_trial_names_a_wrong_renderer(command: list[str], tmp_path: Path) -> None:
    done = carecontact(*command, cwd=tmp_path, MUJOCO_GL="nonsense")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(
        "error: MUJOCO_GL=nonsense: no such OpenGL backend; set it to egl or osmesa, or unset it"
    )


@pytest.mark.parametrize("place", ["argument", "current folder"])
def test_a_name_that_is_no_text_is_one_line(tmp_path: Path, place: str) -> None:
    odd = os.fsdecode(b"run\xff")
    folder = tmp_path / odd
    folder.mkdir()
    out, cwd = (odd, tmp_path) if place == "argument" else ("r", folder)
    done = carecontact("run", "--policy", "hover", "--out", out, cwd=cwd)
    assert done.returncode == 2
    assert done.stderr.startswith("error: the ")
    assert done.stderr.endswith("run\\udcff' holds bytes that are not UTF-8; rename it\n")
    assert done.stderr.count("\n") == 1


def test_what_a_terminal_cannot_show_is_escaped(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from carecontact.cli import main; main(['--version']); print('\\ud800 \u00e9')"],
        env={**os.environ, "PYTHONPATH": SOURCES, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[1] == "\\ud800 \\xe9"


GOES_ON = """
import sys
from pathlib import Path
from carecontact.cli.console import prepare_streams
prepare_streams()
print("begun", flush=True)
sys.stdin.readline()
for stream in (sys.stdout, sys.stderr):
    for text in ("one", "\\ud800", "x" * 100_000):
        print(text, file=stream, flush=True)
Path("done").touch()
"""


def test_a_command_outlives_its_terminal(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", GOES_ON], cwd=tmp_path, stdin=subprocess.PIPE, stdout=theirs, stderr=theirs
    ) as command:
        os.close(theirs)
        assert os.read(ours, 100) == b"begun\r\n"
        os.close(ours)
        command.communicate(b"\n", timeout=60)
    assert (command.returncode, (tmp_path / "done").exists()) == (0, True)


# tyro draws its box with other characters where the terminal has no UTF-8; the line that comes out is the same.

WRONG = {
    ("run", "a:B"): (
        "error: no option takes a:B (did you mean --policy a:B?); For full helptext, run carecontact run --help\n"
    ),
    ("check",): "error: Missing from carecontact check: POLICY; For full helptext, run: carecontact check --help\n",
    ("list", "task"): (
        "error: no choice named 'task' (did you mean 'tasks'?); valid: tasks, actions, regions, segments, spaces, "
        "deltas, controls, robots, policies, protocols, bodies, tissue, metrics, limits, all; For full helptext, run "
        "carecontact list --help\n"
    ),
    ("run", "--demo", "--jobs", "two"): (
        "error: --jobs: expected INT, got 'two'; For full helptext, see carecontact run --help\n"
    ),
    ("serve", "hover", "--port", "x"): (
        "error: --port: expected INT, got 'x'; For full helptext, see carecontact serve --help\n"
    ),
    ("run", "--policy", "hover", "--out", "r", "--tasks", "T1", "T2"): (
        "error: no option takes T2 (did you mean a list with commas, such as --tasks T1,T2 or --seeds 0,1?); For full "
        "helptext, run carecontact run --help\n"
    ),
    ("doctor", "x"): "error: no option takes x; For full helptext, run carecontact doctor --help\n",
}


@pytest.mark.parametrize("arguments", WRONG)
def test_a_wrong_command_line_is_one_line(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err == WRONG[arguments]


@pytest.mark.parametrize("arguments", [("run", "a:B"), ("check",), ("list", "task")], ids=" ".join)
def test_the_line_is_the_same_without_utf_8(arguments: tuple[str, ...], tmp_path: Path) -> None:
    assert carecontact(*arguments, cwd=tmp_path, PYTHONIOENCODING="ascii").stderr == WRONG[arguments]
