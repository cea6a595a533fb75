from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from carecontact.cli import main
from carecontact.errors import ConfigError, LanguageError
from carecontact.policies.language import completion
from carecontact.policies.language.completion import (
    REMOVED,
    Cleaner,
    Completion,
    CompletionRequest,
    Message,
    Replay,
    append_completion,
    one_line,
)
from carecontact.policies.language.live import call_within
from carecontact.recording import Recording, read_recording
from carecontact.recording.notes import read_notes
from tests.policies.language.endpoint import Answer, body, echo, endpoint, says


def request(text: str = "hello", *, model: str = "m-1") -> CompletionRequest:
    return CompletionRequest(
        model=model, messages=(Message(role="user", content=text),), max_tokens=5, prompt_version="p"
    )


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "answers.jsonl"
    append_completion(path, request("a"), Completion(text="A", model="m-1-2026"))
    append_completion(path, request("b"), Completion(text="", refusal="no", model="m-1-2026"))
    return path


def test_what_was_recorded_is_replayed(recorded: Path) -> None:
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
    completed = Completion(text=answer, model="m").model_dump()
    return json.dumps({"key": key or asked.sha256, "request": asked.model_dump(mode="json"), "completion": completed})


@pytest.mark.parametrize(
    ("content", "fault"),
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
def test_a_file_that_is_none(tmp_path: Path, content: str, fault: str) -> None:
    (tmp_path / "bad.jsonl").write_bytes(content.encode("latin-1"))
    with pytest.raises(ConfigError, match=fault):
        Replay(tmp_path / "bad.jsonl")


def test_a_file_that_is_not_there_or_too_large(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        Replay(recorded.parent / "none.jsonl")
    monkeypatch.setattr(completion, "MAX_BYTES", 10)
    with pytest.raises(ConfigError, match="more than"):
        Replay(recorded)


def test_a_record_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(LanguageError, match=r"cannot be recorded in .*: Is a directory"):
        append_completion(tmp_path, request(), Completion(text="", model="m"))


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(ConfigError, match=rf"replay file {path}: expected a regular file"):
            call_within(10, partial(Replay, path))


def test_a_file_that_grows_while_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """What says that it is empty, and is not."""
    monkeypatch.setattr(completion, "MAX_BYTES", 10)
    assert Path("/proc/self/status").stat().st_size == 0
    with pytest.raises(ConfigError, match="more than"):
        Replay("/proc/self/status")


def test_where_an_answer_came_from_is_replayed(tmp_path: Path) -> None:
    given = Completion(text="A", model="m", endpoint="models.example", sent={"max_completion_tokens": 5})
    append_completion(tmp_path / "answers.jsonl", request(), given)
    assert Replay(tmp_path / "answers.jsonl").complete(request()) == given


def test_an_answer_without_an_endpoint_is_written_as_ever(recorded: Path) -> None:
    rows = [json.loads(row) for row in recorded.read_text().splitlines()]
    assert [set(row["completion"]) for row in rows] == [{"text", "refusal", "finish_reason", "model"}] * 2


KEY = "k/ey+\"with'<odd>&parts"


@pytest.mark.parametrize(
    "spelled",
    [
        str,
        str.upper,
        json.dumps,
        repr,
        html.escape,
        quote,
        lambda s: quote(s, safe=""),
        lambda s: s.replace("/", "\\/"),
    ],
)
def test_every_spelling_is_found(spelled: Callable[[str], str]) -> None:
    text = f"before {spelled(KEY)} after"
    cleaned = Cleaner([KEY]).text(text)
    assert REMOVED in cleaned
    assert cleaned.startswith("before ")
    assert cleaned.endswith(" after")
    assert len(cleaned) <= len(f"before '{REMOVED}' after")


@pytest.mark.parametrize("before", ["", "x", "xy", "xyz", "Bearer ", "user:"])
@pytest.mark.parametrize("encode", [base64.b64encode, base64.urlsafe_b64encode])
def test_in_base64_at_any_offset(before: str, encode: Callable[[bytes], bytes]) -> None:
    key = "sk-0123456789??>>secret"
    cleaned = Cleaner([key]).text(encode((before + key + " and more").encode()).decode())
    assert REMOVED in cleaned
    left = base64.b64decode(cleaned.partition(REMOVED)[0] + "==", altchars=b"-_").decode(errors="replace")
    assert key[:2] not in left


def test_a_placeholder_is_no_secret() -> None:
    assert Cleaner(["none", "", "test"]).text('{"side": "none"}') == '{"side": "none"}'
    assert Cleaner().text("x") == "x"


def test_of_two_secrets_the_longer_first() -> None:
    assert Cleaner(["secret", "secret-and-more"]).text("secret-and-more") == REMOVED


def test_what_is_cut_holds_no_part_of_a_secret() -> None:
    assert "secret" not in Cleaner(["secretsecretsecret"]).line("x" * 20 + "secretsecretsecret", limit=32)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a\n\n  b\t", "a b"),
        ("\x1b[31m", r"\x1b[31m"),
        ("x" * 20, "x" * 20),
        ("x" * 21, "x" * 14 + " [...]"),
        ("\x00" * 6, r"\x00\x00\x00\x" + " [...]"),
        ("", ""),
    ],
)
def test_one_line(text: str, line: str) -> None:
    assert one_line(text, limit=20) == line


RUN_KEY = "sk-live-0123456789-SECRET"
BEARER = f"Bearer {RUN_KEY}"
READ = json.dumps({"action": "touch", "region": "forearm", "side": "right", "manner": "none", "unclear": ""})

Run = Callable[..., list[dict[str, Any]]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("OPENAI_API_KEY", RUN_KEY)

    def made(*answers: Answer, seeds: str) -> list[dict[str, Any]]:
        """Rows of the results, in the order of the trials."""
        out, record = tmp_path / "run", tmp_path / "answers.jsonl"
        command = ["run", "--policy", "state-machine", "--language", "live:m-1", "--tasks", "T1", "--seeds", seeds]
        with endpoint(*answers) as server:
            monkeypatch.setenv("OPENAI_BASE_URL", server.url)
            assert main([*command, "--allow-failures", "--jobs", "1", "--out", str(out), "--record", str(record)]) == 0
        assert {asked["key"] for asked in server.asked} == {BEARER}
        _check_all_of_it(tmp_path, capfd.readouterr())
        rows = json.loads((out / "results.json").read_text())["trials"]
        assert {row["language_endpoint"] for row in rows} == {server.url.split("/")[2]}
        return rows

    return made


def _check_all_of_it(folder: Path, printed: Any) -> None:
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert {"results.json", "report.html", "T1-s000.h5", "answers.jsonl"} <= {path.name for path in files}
    kept = [path.read_bytes() for path in files] + [text.encode() for text in printed]
    for path in (path for path in files if path.suffix == ".h5"):
        recording = read_recording(path)
        kept += [array.tobytes() for array in recording.arrays.values()] + [recording.header.model_dump_json().encode()]
    assert any(b"[secret removed]" in content for content in kept)
    assert not any(RUN_KEY[3:].encode() in content for content in kept)


def _calls(recording: Recording) -> list[dict[str, Any]]:
    return [call for note in read_notes(recording) for call in note.content["language"]]


@pytest.mark.slow
def test_in_one_trial(run: Run, tmp_path: Path) -> None:
    (row,) = run(says(READ, model=f"m of {BEARER}"), echo(401), seeds="0")
    assert (row["ended"], row["language_served"]) == ("process_failure", "m of Bearer [secret removed]")
    assert "HTTP 401: Incorrect API key provided: Bearer [secret removed]" in row["failure_message"]
    assert row["language_sent"] == "max_tokens=1024 temperature=0.0"
    read, chose = _calls(read_recording(tmp_path / "run" / "T1-s000.h5"))
    assert (read["purpose"], chose["purpose"], chose["completion_sha256"]) == ("parse", "choose", None)
    assert "Language model served" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.slow
def test_in_each_way_that_an_answer_can_be_none(run: Run, tmp_path: Path) -> None:
    busy, refusal = body(f"<p>{BEARER} is busy</p>".encode()), says(None, refusal=f"not with {BEARER}")
    no_number = says(f"no number, but {BEARER}", model="m" * 500_000)
    rows = run(echo(401), busy, refusal, says(READ), no_number, seeds="0-3")
    faults = ["HTTP 401: Incorrect", "not a chat completion", "is a refusal: not with", "does not fit its schema"]
    for row, expected in zip(rows, faults, strict=True):
        assert row["ended"] == "process_failure"
        assert expected in row["failure_message"]
    assert rows[0]["language_served"] is None
    calls = _calls(read_recording(tmp_path / "run" / "T1-s003.h5"))
    assert [len(call["model"]) for call in calls] == [8, 200, 200]
