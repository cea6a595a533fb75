"""A reference to a policy, as the user writes it: a registered name, ``module:Class`` or ``ws://HOST:PORT``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Self
from urllib.parse import unquote, urlsplit

from carecontact.errors import ConfigError

IMPORTABLE, REMOTE = "module:Class", "ws://HOST:PORT"
"""How the two kinds of reference that are not registered names are written."""


@dataclass(frozen=True, kw_only=True)
class PolicyRef:
    """Where a policy is found. Parse a text once with ``parse`` and pass the reference on."""

    kind: Literal["registered", "importable", "remote"]
    text: str
    """What recordings, manifests and messages show: it never holds credentials."""
    host: str = ""
    """Of a remote policy, as is ``port``."""
    port: int = 0
    credentials: str = field(default="", repr=False)
    """``USER:PASSWORD`` for a remote policy, or empty."""

    def __str__(self) -> str:
        return self.text

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``state-machine``, ``module:Class`` (a function that returns a policy will do) or
        ``ws://[USER:PASSWORD@]HOST:PORT``. Whether a registered name exists is checked when it is looked up.

        Raises ConfigError for a malformed ``module:Class`` or address; the message shows no password.
        """
        if "://" in text:
            return cls._address(text)
        if ":" not in text:
            return cls(kind="registered", text=text)
        module, _, attribute = text.partition(":")
        if not attribute.isidentifier() or not all(part.isidentifier() for part in module.split(".")):
            address = f"; for a policy's server, ws://{text}" if attribute.isdigit() else ""
            raise ConfigError(f"policy {text!r}: expected {IMPORTABLE}, for example my_policy:MyPolicy{address}")
        return cls(kind="importable", text=text)

    @classmethod
    def _address(cls, text: str) -> Self:
        scheme = text.partition("://")[0]
        expected = f"expected {REMOTE}, for example ws://192.0.2.7:8765"
        shown = f"{scheme}://{text.rpartition('@')[2].removeprefix(f'{scheme}://')}"
        if scheme != "ws":
            tunnel = "; for an encrypted connection, use a tunnel such as ssh -L" if scheme == "wss" else ""
            raise ConfigError(f"policy {shown!r}: {expected}{tunnel}")
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise ConfigError(f"policy {shown!r}: {expected}: {error}") from None
        if not host or not port or parts.path not in ("", "/") or parts.query or parts.fragment:
            raise ConfigError(f"policy {shown!r}: {expected}")
        credentials = ""
        if parts.username is not None:
            if not parts.username or parts.password is None:
                raise ConfigError(f"policy {shown!r}: expected USER:PASSWORD before the @")
            credentials = f"{unquote(parts.username)}:{unquote(parts.password)}"
        place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        return cls(kind="remote", text=f"ws://{place}", host=host, port=port, credentials=credentials)
