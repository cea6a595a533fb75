from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli.groups import LanguageGroup
from carecontact.cli.language import language_environment
from carecontact.errors import ConfigError
from carecontact.policies.language import LANGUAGE_VARIABLE, RECORD_VARIABLE
from carecontact.policies.language.completion import Completion, CompletionRequest
from carecontact.policies.language.selection import chosen_transcript, language_name
from carecontact.policies.language.transcript import append_completion
from carecontact.policies.registry import POLICIES


@pytest.fixture
def replay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    asked = CompletionRequest(model="authored", messages=(), max_tokens=1, prompt_version="p")
    append_completion(tmp_path / "r.jsonl", asked, Completion(text="x", model="authored"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "r.jsonl"


def test_the_policys_process_finds_the_file(replay: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = language_environment("state-machine", LanguageGroup(language="replay:r.jsonl", record=None))
    assert given == {LANGUAGE_VARIABLE: f"replay:{replay}", RECORD_VARIABLE: ""}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir("/")
    chosen = chosen_transcript("rules-v1")
    assert chosen is not None
    assert chosen.name == language_name(f"replay:{replay}")
    assert chosen.name.endswith(":authored")


def test_without_the_option_a_shells_own_variables_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, "live:someone")
    for name, value in language_environment("state-machine", LanguageGroup(language=None, record=None)).items():
        monkeypatch.setenv(name, value)
    assert chosen_transcript("rules-v1") is None


def test_rules_and_live(tmp_path: Path) -> None:
    assert language_name("rules-v1") == "rules-v1"
    assert language_name("live:m-1") == "live:m-1"
    given = language_environment("my_module:Mine", LanguageGroup(language="live:m-1", record=tmp_path / "new.jsonl"))
    assert given == {LANGUAGE_VARIABLE: "live:m-1", RECORD_VARIABLE: str(tmp_path / "new.jsonl")}


@pytest.mark.parametrize(
    ("policy", "language", "record", "told"),
    [
        ("hover", "rules-v1", None, "policy hover uses no language backend that can be chosen"),
        ("state-machine", "oracle:x", None, "takes rules-v1, replay, live"),
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
        ("state-machine", "rules-v1", "r", "only the answers of --language live:MODEL"),
        ("state-machine", None, "r", "only the answers of --language live:MODEL"),
        ("state-machine", "live:m", "nowhere/r", "there is no folder nowhere"),
    ],
)
def test_what_cannot_be_is_told(policy: str, language: str | None, record: str | None, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        language_environment(policy, LanguageGroup(language=language, record=Path(record) if record else None))


@pytest.mark.parametrize(
    "name", ["gpt-4o-2024-08-06", "meta-llama/Llama-3.1-8B", "llama3.1:8b", "@cf/x", "ft:gpt:a::b"]
)
def test_names_that_models_have(name: str) -> None:
    assert language_name(f"live:{name}") == f"live:{name}"


def test_an_address_that_is_none_is_told_before_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "me:opensesame@models.example")
    with pytest.raises(ConfigError, match="OPENAI_BASE_URL: expected http") as raised:
        language_environment("state-machine", LanguageGroup(language="live:m", record=None))
    assert "opensesame" not in str(raised.value)


def test_every_language_of_the_registry_is_one() -> None:
    assert {kind for row in POLICIES.values() for kind in row.languages} <= {"rules-v1", "replay", "live"}
