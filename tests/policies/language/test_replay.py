from __future__ import annotations

import json
import os
from functools import partial
from pathlib import Path

import pytest

from carecontact.errors import ConfigError, LanguageError
from carecontact.policies.language import replay
from carecontact.policies.language.completion import Completion, CompletionRequest, Message
from carecontact.policies.language.deadline import call_within
from carecontact.policies.language.replay import Replay
from carecontact.policies.language.transcript import append_completion


def request(text: str = "hello", *, model: str = "m-1") -> CompletionRequest:
    return CompletionRequest(
        model=model, messages=(Message(role="user", content=text),), max_tokens=5, prompt_version="p"
    )


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "said.jsonl"
    append_completion(path, request("a"), Completion(text="A", model="m-1-2026"))
    append_completion(path, request("b"), Completion(text="", refusal="no", model="m-1-2026"))
    return path


def test_what_was_recorded_is_said_again(recorded: Path) -> None:
    source = Replay(recorded)
    assert source.complete(request("a")).text == "A"
    assert source.complete(request("b")).refusal == "no"
    assert source.model == "m-1"
    assert source.name.startswith("replay:")
    assert source.name.endswith(":m-1")
    assert source.name != "replay:" + recorded.read_bytes()[:6].hex() + ":m-1"


def test_the_name_follows_the_content(recorded: Path) -> None:
    before = Replay(recorded).name
    append_completion(recorded, request("c"), Completion(text="C", model="x"))
    assert Replay(recorded).name != before


@pytest.mark.parametrize(
    "changed",
    [
        {"messages": (Message(role="user", content="a "),)},
        {"messages": (Message(role="system", content="a"),)},
        {"model": "m-2"},
        {"temperature": 0.1},
        {"max_tokens": 6},
        {"prompt_version": "q"},
        {"json_schema": {}},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_anything_else_is_a_miss(recorded: Path, changed: dict[str, object]) -> None:
    with pytest.raises(LanguageError, match=r"has no completion for request .* it holds 2"):
        Replay(recorded).complete(request("a").model_copy(update=changed))


def test_the_first_answer_is_kept(recorded: Path) -> None:
    append_completion(recorded, request("a"), Completion(text="another", model="m-1"))
    assert Replay(recorded).complete(request("a")).text == "A"
    assert len(recorded.read_text().splitlines()) == 2


def line(text: str, answer: str, *, model: str = "m-1", key: str | None = None) -> str:
    asked = request(text, model=model)
    said = Completion(text=answer, model="m").model_dump()
    return json.dumps({"key": key or asked.sha256, "request": asked.model_dump(mode="json"), "completion": said})


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "no completion"),
        ("{", "line 1: the line: Invalid JSON"),
        ("\xff\n", "line 1: the line: Invalid JSON"),
        (line("a", "A") + '\n{"key": "k"}', r"line 2: request: Field required"),
        (line("a", "A", key="0" * 64), "line 1: .*key.* 0000"),
        (line("a", "A") + "\n" + line("b", "B", model="m-2"), "line 2: model m-2.* m-1"),
        (line("a", "A", model="x y;rm"), r"line 1: request\.model: expected 1 to 128 letters.*got 'x y;rm'"),
        (
            line("a", "A").replace('"A"', json.dumps("A" * 16385)),
            r"line 1: completion\.text: String should have at most 16384",
        ),
        (line("a", "A")[:-1] + ', "' + "k" * 5000 + '": 1}', r"line 1: k{94} \[\.\.\.\]: Extra inputs"),
        (line("a", "A") + "\n" + line("a", "B"), "line 2: .*another answer to the same request"),
    ],
)
def test_a_file_that_is_none(tmp_path: Path, content: str, told: str) -> None:
    (tmp_path / "bad.jsonl").write_bytes(content.encode("latin-1"))
    with pytest.raises(ConfigError, match=told):
        Replay(tmp_path / "bad.jsonl")


def test_a_file_that_is_not_there_or_too_large(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        Replay(recorded.parent / "none.jsonl")
    monkeypatch.setattr(replay, "MAX_BYTES", 10)
    with pytest.raises(ConfigError, match="more than"):
        Replay(recorded)


def test_a_record_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(LanguageError, match=r"cannot be recorded in .*: Is a directory"):
        append_completion(tmp_path, request(), Completion(text="", model="m"))


def test_what_is_no_file_is_told_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(ConfigError, match=rf"replay file {path}: expected a regular file"):
            call_within(10, partial(Replay, path))


def test_a_file_that_grows_while_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """What says that it is empty, and is not."""
    monkeypatch.setattr(replay, "MAX_BYTES", 10)
    assert Path("/proc/self/status").stat().st_size == 0
    with pytest.raises(ConfigError, match="more than"):
        Replay("/proc/self/status")


def test_where_an_answer_came_from_is_replayed(tmp_path: Path) -> None:
    given = Completion(text="A", model="m", endpoint="models.example", sent={"max_completion_tokens": 5})
    append_completion(tmp_path / "said.jsonl", request(), given)
    assert Replay(tmp_path / "said.jsonl").complete(request()) == given


def test_an_answer_without_an_endpoint_is_written_as_ever(recorded: Path) -> None:
    rows = [json.loads(row) for row in recorded.read_text().splitlines()]
    assert [set(row["completion"]) for row in rows] == [{"text", "refusal", "finish_reason", "model"}] * 2
