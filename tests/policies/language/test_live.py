from __future__ import annotations

import base64
import json
import socket
import sys
import time
import tracemalloc
from collections.abc import Callable
from urllib.parse import quote

import pytest

from carecontact.errors import ConfigError, DependencyError, LanguageError
from carecontact.policies.language import live
from carecontact.policies.language.completion import REMOVED, CompletionRequest, Message
from carecontact.policies.language.live import Live
from tests.policies.language.endpoint import (
    Answer,
    body,
    bomb,
    completion,
    drop,
    echo,
    endpoint,
    error,
    flood,
    redirect,
    refuses,
    says,
    silence,
    slow_headers,
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
        answer = at(monkeypatch, server.url).complete(REQUEST)
    assert (answer.text, answer.model, answer.finish_reason, answer.refusal) == ("good day", "served-1", "stop", None)
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
    assert wanted["type"] == "json_schema"
    assert (wanted["json_schema"]["strict"], wanted["json_schema"]["schema"]) == (True, schema)


def test_a_refusal_is_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    with endpoint(says(None, refusal="I would rather not")) as server:
        answer = at(monkeypatch, server.url).complete(REQUEST)
    assert (answer.text, answer.refusal) == ("", "I would rather not")


@pytest.mark.parametrize(
    "passing", [error(429), error(500), error(503), drop(0), drop(30)], ids=["429", "500", "503", "drop", "cut"]
)
def test_what_may_pass_is_tried_once_more(monkeypatch: pytest.MonkeyPatch, passing: Answer) -> None:
    with endpoint(passing, says("now")) as server:
        assert at(monkeypatch, server.url).complete(REQUEST).text == "now"
    assert len(server.asked) == 2


@pytest.mark.parametrize(
    ("bad", "fault", "asked"),
    [
        (error(400, "no such parameter"), "HTTP 400: .*no such parameter", 1),
        (error(401, "bad key"), "HTTP 401", 1),
        (error(404, "no such model"), "HTTP 404", 1),
        (error(429), "HTTP 429", 2),
        (error(500), "HTTP 500", 2),
        (body(b"<html>busy</html>"), "not a chat completion .*<html>busy", 1),
        (body(b'{"choices": []}'), r"not a chat completion \(choices: ", 1),
        (body(b'{"choices": [{"message": "text"}]}'), r"choices\.0\.message", 1),
        (body(b"[1, 2"), "not a chat completion", 1),
        (body(b""), "not a chat completion", 1),
        (body(b"\xff\xfe"), "not a chat completion", 1),
        (drop(0), "Connection error", 2),
        (drop(30), "incomplete", 2),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_what_is_no_completion_is_named(monkeypatch: pytest.MonkeyPatch, bad: Answer, fault: str, asked: int) -> None:
    with endpoint(bad) as server, pytest.raises(LanguageError, match=rf"^live:m-1: .*{fault}"):
        at(monkeypatch, server.url).complete(REQUEST)
    assert len(server.asked) == asked


@pytest.mark.parametrize(
    "slow",
    [silence(60), slow_headers(0.02), trickle(0.02), trickle(0.02, status=500), trickle(0.02, status=400)],
    ids=["silent", "headers", "body", "500", "400"],
)
def test_a_slow_endpoint_is_given_up(monkeypatch: pytest.MonkeyPatch, slow: Answer) -> None:
    with endpoint(slow, says("now")) as server:
        source = at(monkeypatch, server.url, deadline_s=0.3)
        with pytest.raises(LanguageError, match=r"no whole reply within 0\.3 s"):
            source.complete(REQUEST)
        assert source.complete(REQUEST).text == "now"


def test_a_host_whose_name_is_not_found_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: time.sleep(60))
    source = at(monkeypatch, "http://slow.invalid/v1", deadline_s=0.3)
    with pytest.raises(LanguageError, match=r"no whole reply within 0\.3 s \(endpoint slow\.invalid\)"):
        source.complete(REQUEST)


@pytest.mark.parametrize(
    ("large", "fault"),
    [
        (flood(), "more than 1048576 bytes"),
        (flood(status=400), "HTTP 400: a{400}"),
        (flood(status=307), "HTTP 307: a{400}"),
        (bomb(1 << 28, status=200), "more than 1048576 bytes"),
        (bomb(1 << 28, status=400), "HTTP 400: a{400}"),
    ],
    ids=["200", "400", "307", "packed-200", "packed-400"],
)
def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch, large: Answer, fault: str) -> None:
    with endpoint(large) as server:
        source = at(monkeypatch, server.url)
        tracemalloc.start()
        try:
            with pytest.raises(LanguageError, match=fault):
                source.complete(REQUEST)
            assert tracemalloc.get_traced_memory()[1] < 16 << 20
        finally:
            tracemalloc.stop()


def test_a_redirect_is_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    with endpoint(says("from elsewhere")) as other, endpoint(redirect(f"{other.url}/chat/completions")) as server:
        with pytest.raises(LanguageError, match="HTTP 307"):
            at(monkeypatch, server.url).complete(REQUEST)
        assert not other.asked


@pytest.mark.parametrize("named", [True, False])
def test_parameters_that_are_refused_are_left_out_from_then_on(monkeypatch: pytest.MonkeyPatch, named: bool) -> None:
    picky = refuses("max_tokens", then=refuses("temperature", then=says("good day"), named=named), named=named)
    with endpoint(picky) as server:
        source = at(monkeypatch, server.url)
        assert source.complete(REQUEST).sent == {"max_completion_tokens": 50}
        assert source.complete(REQUEST).sent == {"max_completion_tokens": 50}
    newer = "max_completion_tokens"
    sent = [{"temperature", "max_tokens", newer} & asked.keys() for asked in server.asked]
    assert sent == [{"temperature", "max_tokens"}, {"temperature", newer}, {newer}, {newer}]


@pytest.mark.parametrize(
    ("status", "message", "asked"),
    [(400, "temperature: no", 2), (400, "max_tokens is too large", 2), (400, "no model of that name", 1),
     (400, "max_completion_tokens: no", 1), (422, "temperature: no", 1)],
)  # fmt: skip
def test_an_endpoint_that_goes_on_refusing(
    monkeypatch: pytest.MonkeyPatch, status: int, message: str, asked: int
) -> None:
    with endpoint(error(status, message)) as server:
        source = at(monkeypatch, server.url)
        for times in (1, 2):
            with pytest.raises(LanguageError, match=f"HTTP {status}: {message}"):
                source.complete(REQUEST)
            assert len(server.asked) == asked * times


def test_where_an_answer_comes_from(monkeypatch: pytest.MonkeyPatch) -> None:
    with endpoint(says("x")) as server:
        host = server.url.split("/")[2]
        answer = at(monkeypatch, server.url.replace("//", "//someone:opensesame@")).complete(REQUEST)
    assert (answer.endpoint, answer.sent) == (host, {"temperature": 0.0, "max_tokens": 50})
    assert answer.model_dump()["endpoint"] == host
    assert "endpoint" not in answer.model_copy(update={"endpoint": None}).model_dump()


def _b64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


@pytest.mark.parametrize(
    "spelled",
    [str, quote, _b64, lambda text: _b64("x" + text), lambda text: _b64("xy" + text), str.upper, json.dumps],
    ids=["plain", "url", "base64", "base64+1", "base64+2", "upper", "json"],
)
@pytest.mark.parametrize("place", ["401", "500", "200", "text", "refusal", "model", "finish_reason"])
def test_the_key_is_in_nothing_that_an_echo_says(
    monkeypatch: pytest.MonkeyPatch, place: str, spelled: Callable[[str], str]
) -> None:
    key = "sk-test/0123+456789=Secret"
    monkeypatch.setenv("OPENAI_API_KEY", key)
    echoed = spelled(f"Bearer {key}")
    answers = {"200": body(f"who is {echoed}?".encode()), "text": says(echoed), "model": says("", model=echoed)}
    answers |= {"refusal": says(None, refusal=echoed), "finish_reason": says("", finish_reason=echoed)}
    with endpoint(answers.get(place) or echo(int(place), spelled=spelled)) as server:
        try:
            kept = repr(at(monkeypatch, server.url).complete(REQUEST))
        except LanguageError as raised:
            kept = str(raised)
    assert server.asked[0]["key"] == f"Bearer {key}"
    assert REMOVED in kept
    # Of base64 the bits that the key shares with its neighbours stay.
    longest = echoed if spelled is str else echoed[-12:-4]
    assert longest not in kept
    assert key not in kept


def test_a_password_in_the_address_is_a_secret_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-0123456789")
    with endpoint(echo(401), says("me and opensesame")) as server:
        source = at(monkeypatch, server.url.replace("//", "//me:opensesame@"))
        with pytest.raises(LanguageError) as raised:
            source.complete(REQUEST)
        answer = source.complete(REQUEST)
    # It is sent in the place of the key.
    assert server.asked[0]["key"] == f"Basic {_b64('me:opensesame')}"
    assert f"provided: Basic {REMOVED}" in str(raised.value)
    assert "opensesame" not in str(raised.value)
    assert answer.text == f"me and {REMOVED}"


def test_an_echo_of_a_key_that_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    key = "sk-" + "k" * 60
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with endpoint(body(b"x" * 470 + key.encode(), status=400)) as server:
        with pytest.raises(LanguageError) as raised:
            at(monkeypatch, server.url).complete(REQUEST)
    assert "sk-" not in str(raised.value)


def test_text_is_bounded_and_printable(monkeypatch: pytest.MonkeyPatch) -> None:
    wild = "a\x1b[31m\x00\n\u202e"
    with endpoint(says(f"{wild}\tb", model="m" * 500_000), says(None, refusal=wild * 5000)) as server:
        source = at(monkeypatch, server.url)
        first, second = source.complete(REQUEST), source.complete(REQUEST)
    assert first.text == "a\ufffd[31m\ufffd\n\u202e\tb"
    assert len(first.model) == 200
    assert first.model.endswith("m [...]")
    assert second.refusal is not None
    assert second.refusal.isprintable()
    assert second.refusal.startswith(r"a\x1b[31m\x00 \u202ea")
    assert len(second.refusal) == 2000
    with endpoint(says("x" * 16385)) as server:
        with pytest.raises(LanguageError, match="16385 characters; at most 16384"):
            at(monkeypatch, server.url).complete(REQUEST)


def test_half_a_character_is_no_text(monkeypatch: pytest.MonkeyPatch) -> None:
    content = json.dumps(completion("?")).replace("?", "\\ud800").encode()
    with endpoint(body(content)) as server:
        with pytest.raises(LanguageError, match="not a chat completion"):
            at(monkeypatch, server.url).complete(REQUEST)


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


def test_a_proxy_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTP_PROXY", "ftp://me:opensesame@proxy")
    with pytest.raises(ConfigError, match=r"^live:m-1: .*HTTP client .*_PROXY") as raised:
        Live("m-1")
    assert "opensesame" not in str(raised.value)
