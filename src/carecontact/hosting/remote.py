"""A policy on another host, named by its address: ``ws://HOST:PORT``."""

from __future__ import annotations

from collections.abc import Callable

from carecontact.contract.policy_address import remote_address
from carecontact.errors import ConfigError
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.wire.client import PolicyClient

CREDENTIALS = "CARECONTACT_POLICY_CREDENTIALS"
"""Carries USER:PASSWORD to a trial's process: an address goes into recordings, and they must not."""


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
