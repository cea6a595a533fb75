from __future__ import annotations

import socket
import sys
import time

import pytest

from carecontact.errors import DependencyError, LanguageError
from carecontact.policies.language import live
from carecontact.policies.language.completion import CompletionRequest, Message
from carecontact.policies.language.live import Live
from tests.policies.language.endpoint import (
    Answer,
    body,
    completion,
    drop,
    endpoint,
    error,
    flood,
    says,
    silence,
    trickle,
)

REQUEST = CompletionRequest(
    model="m-1", messages=(Message(role="user", content="hello"),), max_tokens=50, prompt_version="p"
)


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    monkeypatch.setattr(live, "RETRY_PAUSE_S", 0.0)


def at(monkeypatch: pytest.MonkeyPatch, url: str, *, deadline_s: float = 5.0) -> Live:
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    return Live("m-1", deadline_s=deadline_s)


def test_a_completion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    with endpoint(says("good day")) as server:
        said = at(monkeypatch, server.url).complete(REQUEST)
    assert (said.text, said.model, said.finish_reason, said.refusal) == ("good day", "served-1", "stop", None)
    (asked,) = server.asked
    assert (asked["path"], asked["key"]) == ("/v1/chat/completions", "Bearer secret")
    assert asked["messages"] == [{"role": "user", "content": "hello"}]
    assert (asked["model"], asked["temperature"], asked["max_tokens"]) == ("m-1", 0.0, 50)
    assert "response_format" not in asked


def test_a_schema_is_asked_for_in_the_strict_form(monkeypatch: pytest.MonkeyPatch) -> None:
    schema = {"type": "object", "properties": {}, "additionalProperties": False}
    with endpoint(says("{}")) as server:
        at(monkeypatch, server.url).complete(REQUEST.model_copy(update={"json_schema": schema}))
    wanted = server.asked[0]["response_format"]
    assert (wanted["type"], wanted["json_schema"]["strict"], wanted["json_schema"]["schema"]) == (
        "json_schema", True, schema,
    )  # fmt: skip


def test_a_refusal_is_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    with endpoint(says(None, refusal="I would rather not")) as server:
        said = at(monkeypatch, server.url).complete(REQUEST)
    assert (said.text, said.refusal) == ("", "I would rather not")


@pytest.mark.parametrize(
    "passing", [error(429), error(500), error(503), drop(0), drop(30)], ids=["429", "500", "503", "drop", "cut"]
)
def test_what_may_pass_is_tried_once_more(monkeypatch: pytest.MonkeyPatch, passing: Answer) -> None:
    with endpoint(passing, says("now")) as server:
        assert at(monkeypatch, server.url).complete(REQUEST).text == "now"
    assert len(server.asked) == 2


@pytest.mark.parametrize(
    ("bad", "told", "asked"),
    [
        (error(400, "no such parameter"), "HTTP 400: .*no such parameter", 1),
        (error(401, "bad key"), "HTTP 401", 1),
        (error(404, "no such model"), "HTTP 404", 1),
        (error(429), "HTTP 429", 2),
        (error(500), "HTTP 500", 2),
        (body(b"<html>busy</html>"), "no chat completion .*<html>busy", 1),
        (body(b'{"choices": []}'), r"no chat completion \(choices: ", 1),
        (body(b'{"choices": [{"message": "text"}]}'), r"choices\.0\.message", 1),
        (body(b"[1, 2"), "no chat completion", 1),
        (body(b""), "no chat completion", 1),
        (body(b"\xff\xfe"), "no chat completion", 1),
        (drop(0), "Connection error", 2),
        (drop(30), "broke off", 2),
        (flood(), "more than 1048576 bytes", 1),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_what_is_no_completion_is_told(monkeypatch: pytest.MonkeyPatch, bad: Answer, told: str, asked: int) -> None:
    with endpoint(bad) as server, pytest.raises(LanguageError, match=rf"^live:m-1: .*{told}"):
        at(monkeypatch, server.url).complete(REQUEST)
    assert len(server.asked) == asked


@pytest.mark.parametrize("slow", [silence(3), trickle(0.02)], ids=["silent", "trickling"])
def test_a_slow_endpoint_is_given_up(monkeypatch: pytest.MonkeyPatch, slow: Answer) -> None:
    began = time.monotonic()
    with endpoint(slow) as server, pytest.raises(LanguageError, match=r"no whole reply within 0\.3 s"):
        at(monkeypatch, server.url, deadline_s=0.3).complete(REQUEST)
    assert time.monotonic() - began < 2


def test_an_endpoint_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{held.getsockname()[1]}/v1"
        with pytest.raises(LanguageError, match="Connection error"):
            at(monkeypatch, url).complete(REQUEST)


def test_the_endpoint_of_the_tests_is_what_the_client_library_expects(monkeypatch: pytest.MonkeyPatch) -> None:
    from openai import OpenAI
    from openai.types.chat import ChatCompletion

    assert ChatCompletion.model_validate(completion("x"), strict=False).choices[0].message.content == "x"
    with endpoint(says("x")) as server:
        reply = OpenAI(base_url=server.url, api_key="k").chat.completions.create(model="m", messages=[])
    assert reply.choices[0].message.content == "x"


def test_without_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openai", None)
    with pytest.raises(DependencyError, match=r"carecontact\[live\]"):
        Live("m-1")
