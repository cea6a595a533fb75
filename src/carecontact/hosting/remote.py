"""A policy on another host, named by its address: ``ws://HOST:PORT``."""

from __future__ import annotations

from collections.abc import Callable

from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.client import PolicyClient


class RemotePolicy(PolicyConversation):
    """A policy that somebody else started. What it prints and how it ends stay unknown; each trial is a connection."""

    def __init__(self, setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> None:
        """``setup``: of a remote policy; its credentials are sent as HTTP basic authorization."""
        super().__init__(setup.ref.text, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._ref = setup.ref

    def _open(self, left: Callable[[], float]) -> PolicyClient:
        return PolicyClient(
            host=self._ref.host, port=self._ref.port, credentials=self._ref.credentials, deadline_s=left()
        )
