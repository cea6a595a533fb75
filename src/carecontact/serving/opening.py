"""Opens the conversation with a policy: in a process of its own, or on a server elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable

from carecontact.errors import LostError, PolicyError, UnreachableError
from carecontact.interface.policy import API_KEY, PolicyCard
from carecontact.serving.client import Client, PolicyClient, basic_authorization
from carecontact.serving.connection import Connection
from carecontact.serving.conversation import Left, PolicyConversation, PolicySetup, T
from carecontact.serving.process import PolicyProcess

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
"""First and longest pause [s] between attempts to reach a server that is away; each pause is twice the one before."""
MOST_LOSSES = 3
"""Most connections that a call may lose. A server that restarts loses one connection and refuses others for a while; a
server that accepts and loses connections repeatedly crashes because of what it is sent."""
HIDDEN = "***"


class RemotePolicy(PolicyConversation):
    """A conversation with a policy on a server that somebody else started. Each trial is one connection. What the
    policy prints and how it ends stay unknown.
    """

    def __init__(self, setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> None:
        """``setup``: that of a remote policy. Its credentials become HTTP basic authorization or a dialect's key."""
        super().__init__(setup.ref.text, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._ref = setup.ref
        self._card: PolicyCard | None = None
        self._steps: list[Callable[[Left], object]] = []

    def _open(self, left: Left) -> Client:
        ref, authorization = self._ref, basic_authorization(self._ref.credentials)
        if ref.scheme != "ws" and ref.credentials:
            authorization = f"Api-Key {ref.credentials}"
        connection = Connection.open(
            host=ref.host, port=ref.port, path=ref.path, deadline_s=left(), authorization=authorization
        )
        if ref.scheme == "ws":
            return PolicyClient(connection)
        # These imports are local because they load Pillow and SciPy.
        from carecontact.serving.openpi import OpenpiClient
        from carecontact.serving.vla_eval import VlaEvalClient

        options = dict(ref.options)
        if ref.scheme == "vla-eval":
            return VlaEvalClient(connection, options=options)
        return OpenpiClient(connection, scheme=ref.scheme, options=options)

    def _connect(self, left: Left) -> PolicyCard:
        card = super()._connect(left)
        if self._card not in (None, card):
            raise PolicyError("handshake", "the server lost the connection, and then came back with another card")
        self._card = card
        return card

    def _carried_out(self, step: Callable[[Left], T], left: Left) -> T:
        """Repeat the trial from its start if the server was away: before the first answer, nothing was executed."""
        if self._acted or not self.patient:
            return step(left)
        pause_s, losses, again = FIRST_PAUSE_S, 0, list[Callable[[Left], object]]()
        while True:
            try:
                for earlier in again:
                    earlier(left)
                result = step(left)
                break
            except (UnreachableError, LostError) as error:
                losses += isinstance(error, LostError)
                if losses == MOST_LOSSES or left() <= pause_s:
                    raise
                if pause_s == FIRST_PAUSE_S and self.on_wait is not None:
                    self.on_wait(f"{self._shown(str(error))}; trying again for {left():.0f} s")
            self._drop()
            time.sleep(pause_s)
            pause_s, again = min(2 * pause_s, LONGEST_PAUSE_S), self._steps
        self._steps.append(step)
        return result

    def _shown(self, text: str) -> str:
        secret = self._ref.credentials
        return super()._shown(text.replace(secret, HIDDEN) if secret else text)

    def _hint(self, message: str) -> str:
        if self._ref.scheme == "ws":
            return ""
        if "HTTP 401" in message or "HTTP 403" in message:
            return f"; the server wants a key: put it into the variable {API_KEY}"
        return "; the server speaks WebSocket on another path: add it to the address" if "HTTP 404" in message else ""


def open_policy(setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> PolicyConversation:
    """Return a conversation that has not started yet. Raises UnknownNameError for an unknown policy."""
    conversation = RemotePolicy if setup.ref.kind == "remote" else PolicyProcess
    return conversation(setup, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
