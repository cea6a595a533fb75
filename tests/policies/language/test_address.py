from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.policies.language.address import address_of_environment


@pytest.fixture(autouse=True)
def _nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OPENAI_BASE_URL", "OPENAI_API_KEY", "OPENAI_ADMIN_KEY", "OPENAI_CUSTOM_HEADERS", "HTTP_PROXY"):
        monkeypatch.delenv(name, raising=False)


def test_nothing_set() -> None:
    address = address_of_environment()
    assert (address.url, address.endpoint, address.key) == ("https://api.openai.com/v1", "api.openai.com", "")


@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("http://127.0.0.1:8000/v1", "127.0.0.1:8000"),
        ("https://me:opensesame@Models.Example/v1/", "models.example"),
        ("http://[::1]:8000", "[::1]:8000"),
    ],
)
def test_of_the_address_the_host_is_told(monkeypatch: pytest.MonkeyPatch, url: str, endpoint: str) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    assert address_of_environment().endpoint == endpoint


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


@pytest.mark.parametrize(
    "url",
    ["models.example/v1", "ftp://models.example", "http://", "http://[bad/v1", "http://h:99999/v1", "http://h/v1?key=1",
     "http://h/v1#a", "http://h /v1", "http://h/\n", "http://h/" + "a" * 500],
)  # fmt: skip
def test_no_address(monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    with pytest.raises(ConfigError, match="OPENAI_BASE_URL: expected http"):
        address_of_environment()


@pytest.mark.parametrize("key", ["sk secret", "sk-secret\n", "sk-secret\u00e9"])
def test_no_key(monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(ConfigError, match="OPENAI_API_KEY: expected printable ASCII") as raised:
        address_of_environment()
    assert "secret" not in str(raised.value)
