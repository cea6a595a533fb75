"""Address and key of the endpoint, from the variables that OpenAI's own clients read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from urllib.parse import SplitResult, unquote, urlsplit

from carecontact.errors import ConfigError

URL_VARIABLE, KEY_VARIABLE = "OPENAI_BASE_URL", "OPENAI_API_KEY"
DEFAULT_URL = "https://api.openai.com/v1"
MAX_URL = 500
_PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")
_WANTED = "expected http:// or https:// with a host and no query, such as http://127.0.0.1:8000/v1"


@dataclass(frozen=True, kw_only=True)
class Address:
    """The place of the endpoint, and what must not be shown of it."""

    url: str = field(repr=False)
    key: str = field(repr=False)
    """Empty if none was given."""
    endpoint: str
    """``host`` or ``host:port``: the part of the address that may be stored."""
    secrets: tuple[str, ...] = field(repr=False)
    """Every value of the environment that a request carries and that nobody else may see."""


def address_of_environment() -> Address:
    """Return the address. Raises ConfigError that names the variable that is wrong, without its value."""
    url, key = os.environ.get(URL_VARIABLE) or DEFAULT_URL, os.environ.get(KEY_VARIABLE) or ""
    if not all("!" <= c <= "~" for c in key):
        raise ConfigError(f"{KEY_VARIABLE}: expected printable ASCII without spaces or line ends")
    parts = _split(url)
    if parts is None or parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
        raise ConfigError(f"{URL_VARIABLE}: {_WANTED}")
    endpoint = parts.netloc.rpartition("@")[2].lower()
    return Address(url=url, key=key, endpoint=endpoint, secrets=tuple(_secrets(key, parts)))


def _split(url: str) -> SplitResult | None:
    try:
        parts = urlsplit(url)
        # urlsplit checks a port only when it is read.
        _ = parts.port
    except ValueError:
        return None
    return parts if len(url) <= MAX_URL and url.isprintable() and " " not in url else None


def _secrets(key: str, address: SplitResult) -> Iterator[str]:
    yield key
    yield os.environ.get("OPENAI_ADMIN_KEY", "")
    for header in os.environ.get("OPENAI_CUSTOM_HEADERS", "").splitlines():
        value = header.partition(":")[2].strip()
        yield value
        yield value.partition(" ")[2]
    proxies = (_split(os.environ.get(name) or os.environ.get(name.lower()) or "") for name in _PROXIES)
    for parts in (address, *proxies):
        if parts is not None and parts.password:
            user, password = unquote(parts.username or ""), unquote(parts.password)
            yield from (password, f"{user}:{password}")
