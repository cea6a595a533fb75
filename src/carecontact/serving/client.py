"""The benchmark's end of the wire: what every client of a policy's server offers, and the client of our own wire."""

from __future__ import annotations

import base64
import hashlib
import re
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, field

from carecontact.errors import ActionError, ContractError, PolicyError
from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.serving import codec
from carecontact.serving.codec import CLOSE, act_message, reset_message
from carecontact.serving.connection import LATE, Connection, instead, wrong_keys
from carecontact.serving.packing import MAX_REPLY_BYTES, NATIVE, Packing, is_map

NOTE_KEY = re.compile(r"[a-z][a-z0-9_]{0,63}")


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
    """One trial's conversation with a policy: ``card``, ``reset``, and any number of ``act``.

    Every failure is a PolicyError, and its kind says what the policy did; only an ObservationError, for an observation
    that breaks the contract, is the harness's fault.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    @abstractmethod
    def card(self, *, deadline_s: float) -> PolicyCard: ...

    @abstractmethod
    def reset(self, instruction: str, session: Session, *, deadline_s: float) -> None: ...

    @abstractmethod
    def act(self, observation: Observation, *, deadline_s: float) -> ActReply: ...

    @abstractmethod
    def _end(self, *, deadline_s: float) -> None: ...

    def say_goodbye(self, *, deadline_s: float) -> None:
        """Ask the policy to end. A policy that is gone has ended already."""
        with suppress(PolicyError):
            self._end(deadline_s=deadline_s)


class PolicyClient(Client):
    """Speaks the native wire (docs/your-policy.md)."""

    def card(self, *, deadline_s: float) -> PolicyCard:
        frame = self.connection.receive("card", deadline_s=deadline_s, late=LATE)
        return codec.decode_card(_decoded(frame, "card", "card")["card"])

    def reset(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        message = reset_message(instruction, session)
        _decoded(self.connection.ask(message, "ready", deadline_s=deadline_s), "ready", None)

    def act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        message = act_message(observation)
        entries = _decoded(self.connection.ask(message, "actions", deadline_s=deadline_s), "actions", "actions")
        notes = _notes(entries)
        try:
            actions = codec.decode_actions(entries["actions"])
        except ActionError as error:
            raise PolicyError("action", str(error), notes=notes) from None
        return ActReply(actions=actions, sent=message, sent_sha256=sha256(message), notes=notes)

    def _end(self, *, deadline_s: float) -> None:
        self.connection.send(CLOSE, deadline_s=deadline_s)


def sha256(message: bytes) -> bytes:
    return hashlib.sha256(message).digest()


def basic_authorization(credentials: str) -> str:
    """Return the value of the header ``Authorization`` for ``USER:PASSWORD``; empty for empty credentials."""
    return f"Basic {base64.b64encode(credentials.encode()).decode()}" if credentials else ""


def unpacked(frame: bytes | str, what: str, *, packing: Packing = NATIVE, remedy: str = "") -> object:
    """Decode an answer. Raises PolicyError ``garbage``, whose message ends with ``remedy``, if it is no message."""
    if isinstance(frame, str):
        raise PolicyError("garbage", f"expected a binary message, got text {frame!r:.200}{remedy}")
    try:
        return packing.unpack(frame, max_bytes=MAX_REPLY_BYTES)
    except ContractError as error:
        raise PolicyError("garbage", f"{what} {error}{remedy}") from None


def reported(reason: object) -> str:
    if isinstance(reason, str) and reason.strip():
        return reason
    return f"the policy's server reported an error, expected its reason as text, got {reason!r:.80}"


def _decoded(frame: bytes | str, kind: str, field: str | None) -> dict[str, object]:
    """Decode a message that must be of type ``kind`` and have ``field``; a message with actions may also have notes."""
    message = unpacked(frame, kind, remedy=f"; {instead(kind)}")
    entries = message if is_map(message) else {}
    if entries.get("type") == "error":
        failure = entries.get("kind")
        known = failure if isinstance(failure, str) and failure in PolicyError.REPORTED else "exception"
        raise PolicyError(known, reported(entries.get("message")), notes=_notes(entries))
    wrong = wrong_keys(entries, kind=kind, field=field)
    if wrong is not None:
        got = wrong if entries else f"{message!r:.200}"
        raise PolicyError("garbage", f"expected one {kind!r} message, got {got:.300}; {instead(kind)}")
    return entries


def _notes(entries: dict[str, object]) -> dict[str, object]:
    """Return the notes of a message. Raises PolicyError ``garbage`` if they are no map."""
    notes = entries.get("notes", {})
    if not is_map(notes) or not all(NOTE_KEY.fullmatch(key) for key in notes):
        raise PolicyError("garbage", f"notes: expected a map with plain names as keys, got {notes!r:.200}")
    return notes
