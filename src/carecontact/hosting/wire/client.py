"""The harness's end of a conversation with a policy, wherever that policy runs."""

from __future__ import annotations

import base64
import hashlib
import re
import socket
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass

from websockets.sync.client import ClientConnection, connect

from carecontact.contract.action import ACTION_SPACES, Action, ActionSpace
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ActionError, ContractError, PolicyError, UnreachableError
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.messages import CLOSE, act_message, reset_message
from carecontact.hosting.wire.packing import MAX_REPLY_BYTES, is_map, unpack
from carecontact.hosting.wire.refusals import LATE, closed, instead, wrong_keys

NOTE_KEY = re.compile(r"[a-z][a-z0-9_]{0,63}")


@dataclass(frozen=True, kw_only=True)
class ActReply:
    actions: list[Action]
    """1 to MAX_CHUNK as they came; each passes the check of the card's action space, after its ``clip`` if the card
    requests that."""
    sent: bytes
    """The message that carried the observation: everything the policy was shown at this step."""
    sent_sha256: bytes
    """(32,) digest of ``sent``"""
    notes: dict[str, object]
    """What the policy wants to be kept of this step; empty for most."""


class PolicyClient:
    """Speaks the native wire. Every failure is a PolicyError whose kind says what the policy did."""

    _session: Session | None = None
    _space: ActionSpace = ACTION_SPACES["cartesian_pose"]
    _clips = False
    """Whether the card requests that targets outside the workspace are clipped."""
    _sent_bytes = 0
    """Length of the last message."""

    def __init__(self, *, port: int, deadline_s: float, host: str = "127.0.0.1", credentials: str = "") -> None:
        """Connect and read nothing yet. ``credentials``: ``USER:PASSWORD`` for HTTP basic authorization, or nothing.

        Raises UnreachableError if nothing there takes a connection, PolicyError ``handshake`` or ``timeout``.
        """
        self._stack = ExitStack()
        place, until = f"[{host}]:{port}" if ":" in host else f"{host}:{port}", time.monotonic() + deadline_s
        key = base64.b64encode(credentials.encode()).decode()
        try:
            # A socket of our own: no proxy from the environment may come between the harness and the policy.
            sock = socket.create_connection((host, port), timeout=deadline_s)
        except TimeoutError:
            raise UnreachableError("timeout", f"{place} took no connection within {deadline_s:g} s") from None
        except ConnectionRefusedError:
            raise UnreachableError(
                "start", f"nothing listens at {place}; start the policy's server there first"
            ) from None
        except OSError as error:
            raise UnreachableError("start", f"no connection to {place}: {error.strerror or error}") from None
        try:
            sock.settimeout(None)
            self._connection: ClientConnection = self._stack.enter_context(
                connect(
                    f"ws://{place}",
                    sock=sock,
                    additional_headers={"Authorization": f"Basic {key}"} if credentials else None,
                    compression=None,
                    ping_interval=None,
                    max_size=MAX_REPLY_BYTES,
                    open_timeout=max(until - time.monotonic(), 0.0),
                    close_timeout=1,
                )
            )
        except TimeoutError:
            raise PolicyError("timeout", f"no answer to the WebSocket handshake within {deadline_s:g} s") from None
        except Exception as error:
            # Beside its own classes websockets raises AssertionError for some bytes that are not HTTP.
            told = f"{type(error).__name__}: {error}"
            raise PolicyError(
                "handshake", f"the WebSocket handshake with the policy server failed: {told:.300}"
            ) from None

    def card(self, *, deadline_s: float) -> PolicyCard:
        """Receive the card, which also says whether targets outside the workspace are clipped."""
        card = codec.decode_card(self._receive("card", "card", deadline_s=deadline_s)["card"])
        self._clips, self._space = card.out_of_bounds == "clip", ACTION_SPACES[card.action_space]
        return card

    def reset(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        message = reset_message(instruction, session)
        self._session = session
        self._expect_silence()
        started = time.monotonic()
        self._send(message, deadline_s=deadline_s)
        self._receive("ready", None, deadline_s=deadline_s, started=started)

    def act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        """Raises ObservationError if the observation breaks the contract, which is the harness's fault."""
        if self._session is None:
            raise ContractError("PolicyClient.act: expected reset before it, got none")
        message = act_message(observation)
        self._expect_silence()
        started = time.monotonic()
        self._send(message, deadline_s=deadline_s)
        entries = self._receive("actions", "actions", deadline_s=deadline_s, started=started)
        notes = _notes(entries)
        try:
            actions = codec.decode_actions(entries["actions"])
            for i, action in enumerate(actions):
                self._check(action, self._session, place=f"actions[{i}]")
        except ActionError as error:
            raise PolicyError("action", str(error), notes=notes) from None
        return ActReply(actions=actions, sent=message, sent_sha256=hashlib.sha256(message).digest(), notes=notes)

    def _check(self, action: Action, session: Session, *, place: str) -> None:
        try:
            self._space.check(self._space.clip(action, session) if self._clips else action, session)
        except ActionError as error:
            raise ActionError(f"{place}.{error}") from None

    def say_goodbye(self, *, deadline_s: float) -> None:
        """Ask the policy to end; a policy that is gone already has."""
        with suppress(PolicyError):
            self._send(CLOSE, deadline_s=deadline_s)

    def disconnect(self) -> None:
        self._stack.close()

    def _expect_silence(self) -> None:
        """An answer that is there before its question would count for an observation that it never saw."""
        try:
            frame = self._connection.recv(timeout=0)
        except Exception:
            # Nothing there, as it should be; or the line is closed, which the request itself will tell.
            return
        raise PolicyError("garbage", f"expected no message before the next request, got one of {len(frame)} bytes")

    def _send(self, message: bytes, *, deadline_s: float) -> None:
        """A peer that does not read can block a send for ever; closing our end of the line unblocks it."""
        self._sent_bytes = len(message)
        expired = threading.Event()

        def hang_up() -> None:
            expired.set()
            with suppress(OSError):
                self._connection.socket.shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(deadline_s, hang_up)
        timer.start()
        try:
            self._connection.send(message)
        except Exception as error:
            if expired.is_set():
                raise PolicyError("timeout", f"did not read its message within {deadline_s:g} s") from None
            raise closed(error, sent_bytes=self._sent_bytes) from None
        finally:
            timer.cancel()

    def _receive(
        self, kind: str, field: str | None, *, deadline_s: float, started: float | None = None
    ) -> dict[str, object]:
        """The next message, which has to be of type ``kind`` and to have ``field``; with actions notes may come."""
        spent = 0.0 if started is None else time.monotonic() - started
        try:
            frame = self._connection.recv(timeout=max(deadline_s - spent, 0.0))
        except TimeoutError:
            late = f"no {kind} message within {deadline_s:.3g} s{LATE.get(kind, '')}"
            raise PolicyError("timeout", late) from None
        except Exception as error:
            raise closed(error, sent_bytes=self._sent_bytes) from None
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
    """Raises PolicyError ``garbage``."""
    notes = entries.get("notes", {})
    if not is_map(notes) or not all(NOTE_KEY.fullmatch(key) for key in notes):
        raise PolicyError("garbage", f"notes: expected a map with plain names as keys, got {notes!r:.200}")
    return notes
