"""A policy on another host, named by its address: ``ws://HOST:PORT``."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable

from carecontact.errors import PolicyError
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
        try:
            return PolicyClient(
                host=self._ref.host, port=self._ref.port, credentials=self._ref.credentials, deadline_s=left()
            )
        except PolicyError as error:
            if error.kind != "start" or os.strerror(errno.ECONNREFUSED) not in str(error):
                raise
            place = self._ref.text.removeprefix("ws://")
            raise PolicyError("start", f"nothing listens at {place}; start the policy's server there first") from None
