"""--policy-arg and --policy-env, from the command line to the request of a trial; workers only write recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.cli.groups import PolicyGroup
from carecontact.cli.policy import check_policy, policy_setup
from carecontact.policies.registry import POLICIES
from carecontact.recording import read_recording
from carecontact.trials.request import TrialRequest
from tests.cli.test_run_and_demo import fake

__all__ = ["fake"]

RUN = ["run", "--policy", "mine:Mine", "--tasks", "T1", "--seeds", "0", "--out", "r"]
MINE = """
from pathlib import Path
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

class Mine:
    card = PolicyCard(name="mine", cameras=())
    def __init__(self, checkpoint: Path, *, steps: int = 3): ...
    def reset(self, instruction): ...
    def act(self, observation):
        return Action(done=True)
"""


@pytest.fixture
def mine(fake: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    Path("mine.py").write_text(MINE)
    fake.setenv("TOKEN", "sekret-1")
    return fake


def test_they_stand_in_the_recording_the_manifest_and_the_request(
    mine: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--policy-arg", "checkpoint=c.pt", "--policy-arg=steps=4", "--policy-env", "TOKEN"]
    assert main([*RUN, *given]) == 0
    assert "mine:Mine checkpoint=c.pt steps=4: 1 trial" in capsys.readouterr().out
    spec = read_recording("r/T1-s000.h5").header.spec
    assert (spec.policy_arguments, spec.policy_environment) == ({"checkpoint": "c.pt", "steps": "4"}, ("TOKEN",))
    identity = json.loads(Path("r/manifest.json").read_text())["identity"]
    assert (identity["arguments"], identity["environment"]) == (spec.policy_arguments, ["TOKEN"])
    (request,) = Path("requests.jsonl").read_text().splitlines()
    assert TrialRequest.model_validate_json(request).policy.environment == {"TOKEN": "sekret-1"}
    assert not [path for path in Path("r").iterdir() if b"sekret-1" in path.read_bytes()]

    assert main([*RUN, *given]) == 0
    assert len(Path("ran.txt").read_text().splitlines()) == 1, "the same command does only what is missing"
    assert main([*RUN, "--policy-arg", "checkpoint=c.pt", "--policy-env", "TOKEN"]) == 2
    assert "this command has policy arguments checkpoint=c.pt and policy variables TOKEN: use another folder" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], "policy 'mine:Mine' failed at start: it requires the argument 'checkpoint'"),
        (
            ["--policy-arg", "checkpoint=c", "--policy-arg", "stops=3"],
            "it has no argument 'stops'; its arguments: check",
        ),
        (
            ["--policy-arg", "checkpoint=c", "--policy-arg", "steps=x"],
            "expected int, got 'x'; its arguments: ",
        ),
        (["--policy-arg", "checkpoint=c", "--language", "rules-v1"], "it has no argument 'language'"),
        (["--policy-arg", "checkpoint"], "--policy-arg 'checkpoint': expected NAME=VALUE"),
        (["--policy-arg", "a b=1"], "--policy-arg 'a b=1': expected NAME=VALUE"),
        (["--policy-arg", "a=1", "--policy-arg", "a=2"], "--policy-arg: a is given twice"),
        (["--policy-arg", "a=\x1b[2J"], "--policy-arg: arguments: expected at most 64 names with printable texts"),
        (["--policy-env", "NOT_SET_HERE"], "--policy-env NOT_SET_HERE: this variable is not set"),
        (
            ["--policy-env", "PYTHONPATH"],
            "--policy-env PYTHONPATH: carecontact never passes variables that begin with CARECONTACT_ or PYTHON",
        ),
    ],
)
def test_a_wrong_option_is_one_line_before_any_trial(
    mine: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str], says: str
) -> None:
    assert main([*RUN, *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert not Path("r").exists()


@pytest.mark.usefixtures("mine")
def test_a_policy_without_isolation_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    setup = replace(policy_setup("mine:Mine", PolicyGroup(policy_arg=("checkpoint=c.pt",))), isolated=False)
    assert check_policy(setup, deadline_s=60.0) is not None
    assert capsys.readouterr().out.startswith("warning: mine:Mine runs without isolation: switched off; run policies")


def test_an_argument_of_the_audit_is_for_one_policy(
    mine: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for policies in ([], ["--policy", "hover", "zero-action"]):
        assert main(["audit", *policies, "--policy-arg", "steps=3"]) == 2
        assert "name exactly one with --policy" in capsys.readouterr().err
    assert main(["audit", "--policy", "mine:Mine", "--policy-arg", "stops=3"]) == 2
    assert "it has no argument 'stops'" in capsys.readouterr().err


def test_the_list_of_policies_shows_what_each_takes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "policies"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert all("Arguments: " in rows[name] for name in POLICIES)
    assert rows["zero-action"].endswith("Arguments: none.")
    assert rows["state-machine"].endswith("Arguments: language: str = rules-v1, record: Path (optional).")


def test_a_policy_that_cannot_be_imported_does_not_hide_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(POLICIES._rows, "hover", type(POLICIES["hover"])(target="nowhere:Hover", description="x"))
    assert main(["list", "policies"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "unknown, nowhere:Hover cannot be imported: ModuleNotFoundError" in rows["hover"]
    assert "zero-action" in rows


def test_a_variable_that_is_no_text_is_refused_without_its_value(
    mine: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mine.setenv("TOKEN", "sekret-\udcff")
    assert main([*RUN, "--policy-env", "TOKEN"]) == 2
    told = capsys.readouterr().err
    assert told == "error: --policy-env TOKEN: the value of this variable holds bytes that are not UTF-8\n"
