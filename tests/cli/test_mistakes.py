"""Fifteen mistakes of a new user and two more: each is answered in one line that says what to do, without a
traceback."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from carecontact.cli import main

POLICY = """
import tensorfloe
class Helper: ...
class MyPolicy:
    def act(self, observation): ...
"""
HEIR = 'base = "bathing-v1"\nid = "mine-v1"\ndescription = "mine"\n'
RUN = ["run", "--out", "r", "--tasks", "T1", "--seeds", "0", "--policy"]
MISTAKES = {
    "a misspelt option": (
        [*RUN, "hover", "--jbos", "2"],
        "run has no option --jbos (did you mean '--jobs'?); `carecontact run --help` shows all options",
    ),
    "an option of another command": ([*RUN, "hover", "--quick"], "run has no option --quick; `carecontact run --help`"),
    "a misspelt command": (["rnu"], "no command named 'rnu' (did you mean 'run'?); valid: run, "),
    "a policy in place of a command": (["my_policy"], "no command named 'my_policy'; valid: run, "),
    "no folder for the output": (["run", "--policy", "hover"], "Missing from carecontact run: --out PATH"),
    "a word for a number": ([*RUN, "hover", "--jobs", "two"], "--jobs: expected INT, got 'two'"),
    "a task in lower case, and --task for --tasks": (
        ["run", "--policy", "hover", "--out", "r", "--task", "t1"],
        "--tasks: 't1' is not a task of bathing-v1 (did you mean 'T1'?); valid: T1, ",
    ),
    "a misspelt policy": ([*RUN, "state_machine"], "no policy named 'state_machine' (did you mean 'state-machine'?)"),
    "the file in place of the policy": ([*RUN, "my_policy.py"], "(did you mean my_policy:MyPolicy?)"),
    "a policy without its class": ([*RUN, "my_policy"], "(did you mean my_policy:MyPolicy?)"),
    "a misspelt module": ([*RUN, "my_polciy:MyPolicy"], "(did you mean my_policy:MyPolicy?)"),
    "a package that is not installed": ([*RUN, "my_policy:MyPolicy"], "No module named 'tensorfloe'"),
    "no server": ([*RUN, "ws://127.0.0.1:{port}"], "nothing listens at 127.0.0.1:{port}; start the policy's server"),
    "a field that a protocol does not have": (
        [*RUN, "hover", "--set", "physics.dt=0.004"],
        "no field 'dt' in physics (did you mean 'dt_s'?); valid: dt_s, ",
    ),
    "a protocol whose base is gone": ([*RUN, "hover", "--protocol", "gone.toml"], "gone.toml: base: protocol file no"),
    "a tissue set that there is not": (
        [*RUN, "hover", "--protocol", "tissue.toml"],
        "tissue.toml: person.tissue_set: no tissue set named 'manikin' (did you mean 'manikin-like'?); valid: ",
    ),
    "a folder that is not a run": (["report", "."], "holds no recordings (*.h5); name the --out of a run"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_that_says_what_to_do(
    mistake: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my_policy.py").write_text(POLICY)
    Path("gone.toml").write_text(HEIR.replace("bathing-v1", "no.toml"))
    Path("tissue.toml").write_text(HEIR + '[person]\ntissue_set = "manikin"\n')
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    arguments, told = MISTAKES[mistake]
    assert main([argument.replace("{port}", str(port)) for argument in arguments]) == 2
    said = capsys.readouterr()
    line, *traceback = said.err.splitlines()
    assert told.replace("{port}", str(port)) in line
    assert line.startswith("error: ")
    assert "Traceback" not in line + said.out
    assert bool(traceback) == (mistake == "a package that is not installed"), "only where a line of the policy is wrong"
    assert not Path("r").exists()


@pytest.mark.parametrize("command", ["run", "serve", "demo", "score", "report", "compare", "validate", "look", "audit"])
def test_help_reads_well(command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    told = capsys.readouterr().out
    assert command in told
    assert not [bad for bad in ("{None}", "(default: )", "(default: None)", "--null") if bad in told]


def test_synonyms_are_understood(capsys: pytest.CaptureFixture[str]) -> None:
    for given in (["--null", "b"], ["--null=b"], ["--baseline", "b"]):
        assert main(["compare", "nowhere", *given]) == 2
        assert "nowhere: no such folder" in capsys.readouterr().err
