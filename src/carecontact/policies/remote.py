"""A policy on another host, named by its address: ``ws://HOST:PORT``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit

from carecontact.errors import ConfigError
from carecontact.policies.conversation import PolicyConversation
from carecontact.policies.wire.client import PolicyClient

CREDENTIALS = "CARECONTACT_POLICY_CREDENTIALS"
"""Carries USER:PASSWORD to a trial's process: an address goes into recordings, and they must not."""


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


class RemotePolicy(PolicyConversation):
    """A policy that somebody else started. What it prints and how it ends stay unknown; each trial is a connection."""

    def __init__(self, policy: str, *, first_deadline_s: float, deadline_s: float, credentials: str = "") -> None:
        """``credentials``: ``USER:PASSWORD``, sent as HTTP basic authorization, in place of the address's own.

        Raises ConfigError for a malformed address.
        """
        address = remote_address(policy)
        if address is None:
            raise ConfigError(f"policy {policy!r}: expected ws://HOST:PORT")
        super().__init__(str(address), first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._address, self._credentials = address, credentials or address.credentials

    def _open(self, left: Callable[[], float]) -> PolicyClient:
        return PolicyClient(
            host=self._address.host, port=self._address.port, credentials=self._credentials, deadline_s=left()
        )
