from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from carecontact.cli.groups import PolicyGroup
from carecontact.cli.policy import policy_setup
from carecontact.errors import ConfigError
from carecontact.policies.language.completion import Completion, CompletionRequest
from carecontact.policies.language.selection import language_name, transcript_of
from carecontact.policies.language.transcript import append_completion
from carecontact.policies.registry import POLICIES


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
    ("policy", "language", "record", "told"),
    [
        ("hover", "rules-v1", None, "policy hover has no language backend to choose"),
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
def test_what_cannot_be_is_told(policy: str, language: str | None, record: str | None, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        policy_setup(policy, PolicyGroup(language=language, record=Path(record) if record else None))


@pytest.mark.parametrize(
    "name", ["gpt-4o-2024-08-06", "meta-llama/Llama-3.1-8B", "llama3.1:8b", "@cf/x", "ft:gpt:a::b"]
)
def test_names_that_models_have(name: str) -> None:
    assert language_name(f"live:{name}") == f"live:{name}"


def test_an_address_that_is_none_is_told_before_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "me:opensesame@models.example")
    with pytest.raises(ConfigError, match="OPENAI_BASE_URL: expected http") as raised:
        policy_setup("state-machine", PolicyGroup(language="live:m", record=None))
    assert "opensesame" not in str(raised.value)


def test_every_language_of_the_registry_is_one() -> None:
    assert {kind for row in POLICIES.values() for kind in row.languages} <= {"rules-v1", "replay", "live"}
