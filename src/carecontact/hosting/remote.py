"""A policy on another host, named by its address: ``ws://HOST:PORT``."""

from __future__ import annotations

import time
from collections.abc import Callable

from carecontact.errors import UnreachableError
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.client import PolicyClient

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
"""Between two attempts to reach a server that takes no connection; each pause is twice the one before."""


class RemotePolicy(PolicyConversation):
    """A policy that somebody else started. What it prints and how it ends stay unknown; each trial is a connection."""

    def __init__(self, setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> None:
        """``setup``: of a remote policy; its credentials are sent as HTTP basic authorization."""
        super().__init__(setup.ref.text, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._ref = setup.ref

    def _open(self, left: Callable[[], float]) -> PolicyClient:
        pause_s = FIRST_PAUSE_S
        while True:
            try:
                return PolicyClient(
                    host=self._ref.host, port=self._ref.port, credentials=self._ref.credentials, deadline_s=left()
                )
            except UnreachableError:
                if not self.patient or left() <= pause_s:
                    raise
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
