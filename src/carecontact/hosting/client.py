"""The harness's end of a conversation with a policy, whichever wire format its server uses."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, field

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ContractError, PolicyError
from carecontact.hosting.wire.connection import Connection


@dataclass(frozen=True, kw_only=True)
class ActReply:
    actions: list[Action]
    """1 to MAX_CHUNK actions in the order of the answer, with fields of the right types; ``Episode.step`` checks their
    values."""
    sent: bytes
    """The message that carried the observation: everything that the policy was shown at this step."""
    sent_sha256: bytes
    """Digest of ``sent``, 32 bytes. A random session id is left out of the digest, so that equal trials have equal
    digests."""
    notes: dict[str, object] = field(default_factory=dict[str, object])
    """The policy's notes on this step; most policies take none."""


class Client(ABC):
    """One trial's conversation with a policy. Every failure is a PolicyError, and its kind says what the policy did."""

    _begun = False

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    @abstractmethod
    def card(self, *, deadline_s: float) -> PolicyCard:
        """Return the policy's card. Call it once, before the other methods."""

    def reset(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        """Begin the trial."""
        self._begun = True
        self._begin(instruction, session, deadline_s=deadline_s)

    def act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        """Send an observation and return the answer.

        Raises ObservationError if the observation breaks the contract, which is the harness's fault.
        """
        if not self._begun:
            raise ContractError(f"{type(self).__name__}.act: expected reset before it, got none")
        return self._act(observation, deadline_s=deadline_s)

    def say_goodbye(self, *, deadline_s: float) -> None:
        """Ask the policy to end. A policy that is gone has ended already."""
        with suppress(PolicyError):
            self._end(deadline_s=deadline_s)

    def disconnect(self) -> None:
        self.connection.close()

    @abstractmethod
    def _begin(self, instruction: str, session: Session, *, deadline_s: float) -> None: ...

    @abstractmethod
    def _act(self, observation: Observation, *, deadline_s: float) -> ActReply: ...

    @abstractmethod
    def _end(self, *, deadline_s: float) -> None: ...


def sha256(message: bytes) -> bytes:
    return hashlib.sha256(message).digest()
