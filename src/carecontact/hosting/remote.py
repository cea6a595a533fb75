"""A policy on another host, named by its address: ``ws://HOST:PORT``."""

from __future__ import annotations

from collections.abc import Callable

from carecontact.hosting.client import Client
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.client import PolicyClient, basic_authorization
from carecontact.hosting.wire.connection import Connection


class RemotePolicy(PolicyConversation):
    """A policy that somebody else started. What it prints and how it ends stay unknown; each trial is a connection."""

    def __init__(self, setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> None:
        """``setup``: of a remote policy; its credentials are sent as HTTP basic authorization."""
        super().__init__(setup.ref.text, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._ref = setup.ref

    def _open(self, left: Callable[[], float]) -> Client:
        ref = self._ref
        return PolicyClient(
            Connection.open(
                host=ref.host, port=ref.port, deadline_s=left(), authorization=basic_authorization(ref.credentials)
            )
        )
