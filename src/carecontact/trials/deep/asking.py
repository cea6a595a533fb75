"""Sends one request after another to one policy, each as if a trial began with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Self

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.session import Session
from carecontact.errors import ActionError, PolicyError
from carecontact.hosting.conversation import PolicyConversation


class Asking:
    """Makes each request a trial of its own, so that a server that keeps a plan or a chunk answers the present
    request.
    """

    def __init__(
        self,
        conversation: PolicyConversation,
        session: Session,
        *,
        check: Callable[[Action], object],
        listen: Callable[[PolicyConversation], None],
        reopen: Callable[[], PolicyConversation],
        took_s: list[float],
    ) -> None:
        self._conversation, self._session = conversation, session
        self._check, self._listen, self._reopen, self._took_s = check, listen, reopen, took_s
        self._own: PolicyConversation | None = None
        self.last: Sequence[Action] = ()
        """Actions of the last answer."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._own is not None:
            self._own.close()

    def ask(self, observation: Observation, *, may_refuse: bool) -> Sequence[Action] | None:
        """Return the answer; None if the policy refuses, after which it is connected again.

        Raises PolicyError if the policy fails and ``may_refuse`` is false.
        """
        try:
            self._begin(observation.instruction)
            started = time.monotonic()
            self.last = self._conversation.act(observation).actions
            self._took_s.append(time.monotonic() - started)
            for number, action in enumerate(self.last):
                try:
                    self._check(action)
                except ActionError as error:
                    self._conversation.refuse(number, error)
        except PolicyError:
            if not may_refuse:
                raise
            self._connect_again()
            return None
        return self.last

    def _begin(self, instruction: str) -> None:
        """Begin a trial; a policy that accepts only one reset on each connection gets a new connection."""
        try:
            self._conversation.reset(instruction, self._session)
        except PolicyError:
            self._connect_again()
            self._conversation.reset(instruction, self._session)

    def _connect_again(self) -> None:
        if self._own is not None:
            self._own.close()
        self._conversation = self._own = self._reopen()
        self._listen(self._own)
        self._own.start()
