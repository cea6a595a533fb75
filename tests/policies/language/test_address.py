from __future__ import annotations

import threading

import pytest

from carecontact.errors import ConfigError
from carecontact.policies.language.completion import CompletionRequest
from carecontact.policies.language.live import Sampling, address_of_environment, call_within


@pytest.fixture
def _nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OPENAI_BASE_URL", "OPENAI_API_KEY", "OPENAI_ADMIN_KEY", "OPENAI_CUSTOM_HEADERS", "HTTP_PROXY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("_nothing_set")
def test_nothing_set() -> None:
    address = address_of_environment()
    assert (address.url, address.endpoint, address.key) == ("https://api.openai.com/v1", "api.openai.com", "")


@pytest.mark.usefixtures("_nothing_set")
@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("http://127.0.0.1:8000/v1", "127.0.0.1:8000"),
        ("https://me:opensesame@Models.Example/v1/", "models.example"),
        ("http://[::1]:8000", "[::1]:8000"),
    ],
)
def test_of_the_address_the_host_is_shown(monkeypatch: pytest.MonkeyPatch, url: str, endpoint: str) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    assert address_of_environment().endpoint == endpoint


@pytest.mark.usefixtures("_nothing_set")
def test_every_secret_is_known_and_none_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "https://me:open%20sesame@models.example/v1")
    monkeypatch.setenv("OPENAI_API_KEY", "sk-1")
    monkeypatch.setenv("OPENAI_ADMIN_KEY", "sk-2")
    monkeypatch.setenv("OPENAI_CUSTOM_HEADERS", "X-Gate: Basic sk-3\nX-Other: sk-4")
    monkeypatch.setenv("HTTP_PROXY", "http://it:sk-5@proxy:3128")
    address = address_of_environment()
    assert {"sk-1", "sk-2", "sk-3", "sk-4", "sk-5", "open sesame", "me:open sesame"} <= set(address.secrets)
    assert "sk-" not in repr(address)
    assert "sesame" not in repr(address)


NO_PLACES = ("", "[bad/v1", "h:99999/v1", "h/v1?key=1", "h/v1#a", "h /v1", "h/\n", "h/" + "a" * 500)


@pytest.mark.usefixtures("_nothing_set")
@pytest.mark.parametrize("url", ["models.example/v1", "ftp://models.example", *(f"http://{p}" for p in NO_PLACES)])
def test_no_address(monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    with pytest.raises(ConfigError, match="OPENAI_BASE_URL: expected http"):
        address_of_environment()


@pytest.mark.usefixtures("_nothing_set")
@pytest.mark.parametrize("key", ["sk secret", "sk-secret\n", "sk-secret\u00e9"])
def test_no_key(monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(ConfigError, match="OPENAI_API_KEY: expected printable ASCII") as raised:
        address_of_environment()
    assert "secret" not in str(raised.value)


def test_what_is_in_time_is_returned_or_raised() -> None:
    assert call_within(5, lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        call_within(5, lambda: 1 // 0)


def test_what_is_late_is_left_to_itself() -> None:
    held = threading.Event()
    with pytest.raises(TimeoutError):
        call_within(0.05, held.wait)
    held.set()


def test_what_is_late_already_is_not_begun() -> None:
    begun = list[int]()
    with pytest.raises(TimeoutError):
        call_within(0, lambda: begun.append(1))
    assert not begun


REQUEST = CompletionRequest(model="m", messages=(), max_tokens=5, temperature=0.5, prompt_version="p")
USUAL, NEWER = Sampling(), Sampling(limit="max_completion_tokens")


def test_what_is_sent() -> None:
    assert USUAL.parameters(REQUEST) == {"temperature": 0.5, "max_tokens": 5}
    assert Sampling(temperature=False, limit="max_completion_tokens").parameters(REQUEST) == {
        "max_completion_tokens": 5
    }


@pytest.mark.parametrize(
    ("parameter", "message", "expected"),
    [
        ("max_tokens", "Use 'max_completion_tokens' instead.", NEWER),
        (None, "'max_tokens' is not supported. Use 'max_completion_tokens' instead.", NEWER),
        ("temperature", "Only the default (1) value is supported.", Sampling(temperature=False)),
        (None, "temperature and max_tokens", Sampling(temperature=False, limit="max_completion_tokens")),
        ("model", "the model takes no temperature", USUAL),
        (None, "max_completion_tokens is too large", USUAL),
        (None, "no", USUAL),
    ],
)
def test_what_an_error_changes(parameter: str | None, message: str, expected: Sampling) -> None:
    assert USUAL.adapted(parameter, message) == expected
    assert expected.adapted(parameter, message) == expected
