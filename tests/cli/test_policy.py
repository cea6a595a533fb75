"""--policy-arg and --policy-env, from the command line to the request of a trial; workers only write recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from carecontact.cli import main
from carecontact.cli.groups import PolicyGroup
from carecontact.cli.policy import check_policy, classes, policy_setup, suggestion
from carecontact.errors import ConfigError
from carecontact.policies.language.completion import Completion, CompletionRequest, append_completion
from carecontact.policies.language.live import language_name, transcript_of
from carecontact.policies.registry import POLICIES
from carecontact.recording import read_recording
from carecontact.running.engine import TrialRequest

RUN = ["run", "--policy", "mine:Mine", "--tasks", "T1", "--seeds", "0", "--out", "r"]
MINE = """
from pathlib import Path
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

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
def test_a_policy_without_isolation_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    setup = replace(policy_setup("mine:Mine", PolicyGroup(policy_arg=("checkpoint=c.pt",))), isolated=False)
    assert check_policy(setup, deadline_s=60.0) is not None
    assert capsys.readouterr().out.startswith("warning: mine:Mine runs without isolation: switched off; run policies")


def test_an_argument_of_the_audit_is_for_one_policy(
    mine: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for policies in ([], ["--policy", "hover", "zero-action"]):
        assert main(["verify", "leaks", *policies, "--policy-arg", "steps=3"]) == 2
        assert "name exactly one with --policy" in capsys.readouterr().err
    assert main(["verify", "leaks", "--policy", "mine:Mine", "--policy-arg", "stops=3"]) == 2
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
    printed = capsys.readouterr().err
    assert printed == "error: --policy-env TOKEN: the value of this variable holds bytes that are not UTF-8\n"


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("mine", " (did you mean mine:Own?)"),
        ("mine.py", " (did you mean mine:Own?)"),
        ("mine:own", " (did you mean mine:Own?)"),
        ("mien:Own", " (did you mean mine:Own?)"),
        ("mine:Own", ""),
        ("mine.Own", " (did you mean mine:Own?)"),
        ("mien.own", " (did you mean mine:Own?)"),
        ("./mine.py:Own", " (did you mean mine:Own?)"),
        ("inner/deep.py", " (did you mean inner.deep:Deep?)"),
        ("inner.deep.Deep", " (did you mean inner.deep:Deep?)"),
        ("inner.deep:Dep", " (did you mean inner.deep:Deep?)"),
        ("inner.deep:Deep", ""),
        ("gone.deep:Deep", ""),
        ("", ""),
        (":", ""),
        ("..", ""),
        ("plain", " (did you mean plain:A or plain:B?)"),
        ("broken", ""),
        ("state-machine", ""),
    ],
)
def test_what_was_meant_comes_from_the_files_without_importing_them(tmp_path: Path, typed: str, message: str) -> None:
    (tmp_path / "mine.py").write_text("raise SystemExit\nclass Helper: ...\nclass Own:\n    def act(self, o): ...\n")
    (tmp_path / "plain.py").write_text("class A: ...\nclass B: ...\n")
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "deep.py").write_text("class Deep: ...\n")
    (tmp_path / "broken.py").write_text("class :\n")
    assert suggestion(typed, tmp_path) == message


def test_a_file_of_another_folder_is_named_with_it(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "mine.py").write_text("class Own:\n    def act(self, o): ...\n")
    printed = f" (did you mean mine:Own, given in the folder {tmp_path.resolve()}?)"
    for typed in ("../mine.py", "../mine.py:Own", str(tmp_path / "mine.py")):
        assert suggestion(typed, tmp_path / "here") == printed
    assert suggestion(str(tmp_path / "mine.py"), tmp_path) == " (did you mean mine:Own?)"
    assert suggestion("../none.py", tmp_path / "here") == ""


def test_a_file_that_is_not_there_has_no_classes(tmp_path: Path) -> None:
    assert classes(tmp_path / "gone.py") == []


@pytest.fixture
def replay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    asked = CompletionRequest(model="authored", messages=(), max_tokens=1, prompt_version="p")
    append_completion(tmp_path / "r.jsonl", asked, Completion(text="x", model="authored"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "r.jsonl"


@pytest.mark.parametrize("spelled", [{"language": "replay:r.jsonl"}, {"policy_arg": ("language=replay:r.jsonl",)}])
def test_the_policys_process_finds_the_file(
    replay: Path, monkeypatch: pytest.MonkeyPatch, spelled: dict[str, Any]
) -> None:
    setup = policy_setup("state-machine", PolicyGroup(**spelled))
    assert (setup.language, setup.record, setup.arguments) == (f"replay:{replay}", None, {})
    monkeypatch.chdir("/")
    chosen = transcript_of(setup.language)
    assert chosen is not None
    assert chosen.name == language_name(f"replay:{replay}")
    assert chosen.name.endswith(":authored")


def test_the_same_option_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match="--language and --policy-arg language= mean the same"):
        policy_setup("state-machine", PolicyGroup(language="rules-v1", policy_arg=("language=rules-v1",)))


def test_a_language_of_a_policy_of_ones_own_is_an_argument_like_any_other() -> None:
    setup = policy_setup("my_module:Mine", PolicyGroup(policy_arg=("language=de",)))
    assert (setup.language, setup.arguments) == (None, {"language": "de"})


def test_rules_and_live(tmp_path: Path) -> None:
    assert language_name("rules-v1") == "rules-v1"
    assert language_name("live:m-1") == "live:m-1"
    setup = policy_setup("my_module:Mine", PolicyGroup(language="live:m-1", record=tmp_path / "new.jsonl"))
    assert (setup.language, setup.record) == ("live:m-1", str(tmp_path / "new.jsonl"))


@pytest.mark.parametrize(
    ("policy", "language", "record", "message"),
    [
        ("hover", "rules-v1", None, "policy hover takes no --language"),
        ("state-machine", "oracle:x", None, "takes rules-v1 or replay:FILE.jsonl or live:MODEL"),
        ("my_module:Mine", "oracle", None, "expected rules-v1, replay:FILE.jsonl or live:MODEL"),
        ("state-machine", "live:", None, "expected a model after it"),
        ("state-machine", "live:x y;rm", None, "language 'live:x y;rm': expected as MODEL 1 to 128 letters"),
        ("state-machine", "live:-rf", None, "expected as MODEL"),
        ("state-machine", "live:" + "m" * 129, None, "expected as MODEL"),
        ("state-machine", "live:m\n", None, "expected as MODEL"),
        ("state-machine", "replay:none.jsonl", None, "No such file"),
        ("state-machine", "replay:", None, "--language replay:: expected a file after it"),
        ("state-machine", "replay", None, "--language replay: expected a file after it"),
        ("state-machine", "replay:/dev/zero", None, "/dev/zero: expected a regular file"),
        ("state-machine", "replay:" + "a" * 5000, None, "File name too long"),
        ("state-machine", "live:m", "/dev/zero", "--record /dev/zero: expected a new or regular file"),
        ("state-machine", "live:m", "/", "--record /: expected a new or regular file"),
        ("state-machine", "rules-v1", "r", "--record needs --language live:MODEL"),
        ("state-machine", None, "r", "--record needs --language live:MODEL"),
        ("state-machine", "live:m", "nowhere/r", "the folder nowhere does not exist"),
    ],
)
def test_what_cannot_be_is_named(policy: str, language: str | None, record: str | None, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        policy_setup(policy, PolicyGroup(language=language, record=Path(record) if record else None))


@pytest.mark.parametrize(
    "name", ["gpt-4o-2024-08-06", "meta-llama/Llama-3.1-8B", "llama3.1:8b", "@cf/x", "ft:gpt:a::b"]
)
def test_names_that_models_have(name: str) -> None:
    assert language_name(f"live:{name}") == f"live:{name}"


def test_an_address_that_is_none_is_named_before_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "me:opensesame@models.example")
    with pytest.raises(ConfigError, match="OPENAI_BASE_URL: expected http") as raised:
        policy_setup("state-machine", PolicyGroup(language="live:m", record=None))
    assert "opensesame" not in str(raised.value)


def test_every_language_of_the_registry_is_one() -> None:
    assert {kind for row in POLICIES.values() for kind in row.languages} <= {"rules-v1", "replay", "live"}
