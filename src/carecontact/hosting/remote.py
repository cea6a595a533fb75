"""A policy on another host, named by its address: ``ws://HOST:PORT`` or that of a dialect."""

from __future__ import annotations

import time
from collections.abc import Callable

from carecontact.contract.policy_ref import API_KEY, PolicyRef
from carecontact.errors import UnreachableError
from carecontact.hosting.client import Client
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.client import PolicyClient, basic_authorization
from carecontact.hosting.wire.connection import Connection

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
"""Between two attempts to reach a server that takes no connection; each pause is twice the one before."""
HIDDEN = "***"


class RemotePolicy(PolicyConversation):
    """A policy that somebody else started. What it prints and how it ends stay unknown; each trial is a connection."""

    def __init__(self, setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> None:
        """``setup``: of a remote policy. Its credentials become HTTP basic authorization, or a dialect's key."""
        super().__init__(setup.ref.text, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._ref = setup.ref

    def _open(self, left: Callable[[], float]) -> Client:
        ref, pause_s = self._ref, FIRST_PAUSE_S
        while True:
            try:
                connection = Connection.open(
                    host=ref.host, port=ref.port, path=ref.path, deadline_s=left(), authorization=_authorization(ref)
                )
            except UnreachableError:
                if not self.patient or left() <= pause_s:
                    raise
            else:
                return _client(ref, connection)
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def _shown(self, text: str) -> str:
        secret = self._ref.credentials
        return super()._shown(text.replace(secret, HIDDEN) if secret else text)

    def _hint(self, message: str) -> str:
        if self._ref.scheme == "ws":
            return ""
        if "HTTP 401" in message or "HTTP 403" in message:
            return f"; the server wants a key: put it into the variable {API_KEY}"
        return "; the server speaks WebSocket on another path: add it to the address" if "HTTP 404" in message else ""


def _authorization(ref: PolicyRef) -> str:
    if ref.scheme == "ws" or not ref.credentials:
        return basic_authorization(ref.credentials)
    return f"Api-Key {ref.credentials}"


def _client(ref: PolicyRef, connection: Connection) -> Client:
    if ref.scheme == "ws":
        return PolicyClient(connection)
    # Imported where they are needed: they bring Pillow and SciPy.
    from carecontact.hosting.dialects.openpi import OpenpiClient
    from carecontact.hosting.dialects.vla_eval import VlaEvalClient

    options = dict(ref.options)
    if ref.scheme == "vla-eval":
        return VlaEvalClient(connection, options=options)
    return OpenpiClient(connection, scheme=ref.scheme, options=options)
