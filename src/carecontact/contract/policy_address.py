"""Where a policy on another host is reached: ``ws://HOST:PORT``."""

from __future__ import annotations

from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit

from carecontact.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Address:
    host: str
    port: int
    credentials: str = field(default="", repr=False)
    """``USER:PASSWORD`` or nothing."""

    def __str__(self) -> str:
        """Without the credentials."""
        return f"ws://[{self.host}]:{self.port}" if ":" in self.host else f"ws://{self.host}:{self.port}"


def remote_address(policy: str) -> Address | None:
    """None for what is no address. Raises ConfigError for an address that is none of ``ws://[USER:PASSWORD@]HOST:PORT``."""
    scheme, separator, _ = policy.partition("://")
    if not separator:
        return None
    expected = "expected ws://HOST:PORT, for example ws://192.0.2.7:8765"
    # Whatever is wrong with it, a message must not show a password.
    shown = f"{scheme}://{policy.rpartition('@')[2].removeprefix(f'{scheme}://')}"
    if scheme != "ws":
        told = "; for an encrypted line put it through a tunnel such as ssh -L" if scheme == "wss" else ""
        raise ConfigError(f"policy {shown!r}: {expected}{told}")
    try:
        parts = urlsplit(policy)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ConfigError(f"policy {shown!r}: {expected}: {error}") from None
    if not host or not port or parts.path not in ("", "/") or parts.query or parts.fragment:
        raise ConfigError(f"policy {shown!r}: {expected}")
    secret = ""
    if parts.username is not None:
        if not parts.username or parts.password is None:
            raise ConfigError(f"policy {shown!r}: before the @ comes USER:PASSWORD")
        secret = f"{unquote(parts.username)}:{unquote(parts.password)}"
    return Address(host=host, port=port, credentials=secret)
