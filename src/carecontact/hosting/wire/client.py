"""The client of the native wire."""

from __future__ import annotations

import base64
import re

from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ActionError, ContractError, PolicyError
from carecontact.hosting.client import ActReply, Client, sha256
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.messages import CLOSE, act_message, reset_message
from carecontact.hosting.wire.packing import MAX_REPLY_BYTES, is_map, unpack
from carecontact.hosting.wire.refusals import LATE, instead, wrong_keys

NOTE_KEY = re.compile(r"[a-z][a-z0-9_]{0,63}")


class PolicyClient(Client):
    """Speaks the native wire (docs/wire.md)."""

    def card(self, *, deadline_s: float) -> PolicyCard:
        frame = self.connection.receive("card", deadline_s=deadline_s, late=LATE["card"])
        return codec.decode_card(_decoded(frame, "card", "card")["card"])

    def _begin(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        message = reset_message(instruction, session)
        _decoded(self.connection.ask(message, "ready", deadline_s=deadline_s), "ready", None)

    def _act(self, observation: Observation, *, deadline_s: float) -> ActReply:
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


def basic_authorization(credentials: str) -> str:
    """Return the value of the header ``Authorization`` for ``USER:PASSWORD``; empty for empty credentials."""
    return f"Basic {base64.b64encode(credentials.encode()).decode()}" if credentials else ""


def _decoded(frame: bytes | str, kind: str, field: str | None) -> dict[str, object]:
    """Decode a message that must be of type ``kind`` and have ``field``; a message with actions may also have notes."""
    if isinstance(frame, str):
        raise PolicyError("garbage", f"expected a binary message, got text {frame!r:.200}; {instead(kind)}")
    try:
        message = unpack(frame, max_bytes=MAX_REPLY_BYTES)
    except ContractError as error:
        raise PolicyError("garbage", f"{kind} {error}; {instead(kind)}") from None
    entries = message if is_map(message) else {}
    if entries.get("type") == "error":
        said, reason = entries.get("kind"), entries.get("message")
        if not isinstance(reason, str) or not reason.strip():
            reason = f"the policy's server reported an error, expected its reason as text, got {reason!r:.80}"
        known = said if isinstance(said, str) and said in PolicyError.REPORTED else "exception"
        raise PolicyError(known, reason, notes=_notes(entries))
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
