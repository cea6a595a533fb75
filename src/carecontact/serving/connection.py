"""One connection of the wire: bounded messages, deadlines, and what a refusal says."""

from __future__ import annotations

import logging
import math
import socket
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import Self

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from carecontact.errors import ExhaustedError, LostError, PolicyError, UnreachableError, did_you_mean
from carecontact.serving.packing import MAX_REPLY_BYTES
from carecontact.system import is_exhausted

EXAMPLES = {
    "card": '{"type": "card", "card": {"name": "my-policy", "modalities": ["rgb"], "cameras": ["overhead"]}}',
    "ready": '{"type": "ready"}',
    "actions": '{"type": "actions", "actions": [{"pose_tcp_in_base": [x, y, z, qw, qx, qy, qz]}]}',
}
"""Kind of message -> an example that a policy's server may send instead; docs/your-policy.md has every message."""
LATE = "; a server sends its card first, unasked; if it serves one trial at a time, run with --jobs 1"
"""What may help if no card comes."""
MESSAGE_TOO_BIG, PROTOCOL_ERROR, INVALID_DATA, INTERNAL_ERROR = 1009, 1002, 1007, 1011
GOING_AWAY, RESTART, TRY_AGAIN = 1001, 1012, 1013
"""Close codes of RFC 6455, section 7.4.1, and of IANA's registry of them."""
PROXY_ALONE = (502, 503, 504)
"""Statuses of HTTP: bad gateway, service unavailable, gateway timeout."""


CLOSE_S = 1.0
"""Time [s] for closing a connection, in addition to the deadline of the call that failed."""
MAX_UNREAD_FRAMES = 1
"""If more frames than this are unread, nothing more is read from the line. A peer that sends many of the largest frames
can therefore fill the memory of about four of them; a peer that answers requests sends one frame at a time."""
_UNHEARD = logging.getLogger(__name__)
"""A logger without readers, for the tracebacks that websockets logs about a line that was cut."""
_UNHEARD.addHandler(logging.NullHandler())


def instead(kind: str) -> str:
    """Return what a policy's server may send as a message of this kind."""
    return f"send {EXAMPLES[kind]} as one binary message of msgpack (docs/your-policy.md)"


def wrong_keys(entries: Mapping[str, object], *, kind: str, field: str | None) -> str | None:
    """Return what is wrong with the keys of a message of type ``kind`` with one field; None if nothing is."""
    wanted = {"type", *filter(None, [field])}
    allowed = wanted | ({"notes"} if kind == "actions" else set[str]())
    unknown, missing = sorted(entries.keys() - allowed), sorted(wanted - entries.keys())
    if not unknown and not missing and entries["type"] == kind:
        return None
    parts = [f"type {entries.get('type')!r}"]
    if unknown:
        parts.append(f"unknown key {', '.join(f'{name:.80}{did_you_mean(name, allowed)}' for name in unknown)}")
    if missing:
        parts.append(f"missing {', '.join(missing)}")
    return "; ".join(parts)


def closed(error: Exception, *, sent_bytes: int) -> PolicyError:
    """Return why a call failed: a LostError where the server gave no reason, or is about to restart.

    ``error``: ConnectionClosed, or the AssertionError of websockets when the peer vanishes in the middle of a call.
    """
    if isinstance(error, ConnectionClosed):
        sent, received = error.sent, error.rcvd
        if received is not None and error.rcvd_then_sent is not False:
            failure = LostError if received.code in (GOING_AWAY, RESTART, TRY_AGAIN) else PolicyError
            kind = "oversize" if received.code == MESSAGE_TOO_BIG else "died"
            return failure(kind, _refused(received.code, sent_bytes))
        if sent is not None and sent.code == MESSAGE_TOO_BIG:
            return PolicyError("oversize", f"expected a reply of at most {MAX_REPLY_BYTES} bytes, got a longer one")
        if sent is not None and sent.code in (PROTOCOL_ERROR, INVALID_DATA):
            return PolicyError("garbage", f"the reply is not WebSocket: {sent.reason}")
    return LostError("died", "the connection closed without an answer")


def absent(error: Exception) -> str:
    """Return how a failed handshake shows that only a tunnel or proxy answered; empty if a server did."""
    if isinstance(error, InvalidStatus) and error.response.status_code in PROXY_ALONE:
        return f"a proxy there answers HTTP {error.response.status_code}"
    if isinstance(error, ConnectionResetError) or isinstance(error.__cause__, EOFError | ConnectionResetError):
        return "the connection was closed before the WebSocket handshake, as ssh -L does without a server behind it"
    return ""


def _refused(code: int, sent_bytes: int) -> str:
    if code == MESSAGE_TOO_BIG:
        return (
            f"the policy's server refused a message of {sent_bytes} bytes (close code {code}): raise its limit, in "
            "Python's websockets with serve(..., max_size=None)"
        )
    if code == INTERNAL_ERROR:
        return (
            f"the policy's server raised an exception (close code {code}): see its own output; it may send an error "
            "message with the traceback instead (docs/your-policy.md). A common cause: msgpack cannot pack numpy's "
            "float32 or bool_; send plain numbers"
        )
    return f"the policy's server closed the connection without an answer (close code {code})"


class Connection:
    """The WebSocket below every dialect. It handles frames and deadlines without knowing their meaning."""

    on_sent: Callable[[bytes], None] | None = None
    """Called with every message that has been sent; the audit uses it."""
    on_received: Callable[[bytes | str], None] | None = None
    """Called with every awaited frame before it is decoded."""

    def __init__(self, websocket: ClientConnection, deadline: Deadline) -> None:
        """``websocket``: open, with MAX_REPLY_BYTES as its limit, without pings and compression."""
        self._websocket, self._deadline = websocket, deadline
        self._stack = ExitStack()
        self._sent_bytes = 0

    @classmethod
    def open(
        cls,
        *,
        port: int,
        deadline_s: float,
        host: str = "127.0.0.1",
        path: str = "/",
        authorization: str = "",
        line: socket.socket | None = None,
    ) -> Self:
        """Connect without reading anything; ``line``: a socket that is already connected, which this object then owns.

        Raises UnreachableError if nothing accepts a connection there, PolicyError ``handshake`` or ``timeout`` if the
        WebSocket cannot be opened, ExhaustedError if this process gets no thread for it.
        """
        place, until = f"[{host}]:{port}" if ":" in host else f"{host}:{port}", time.monotonic() + deadline_s
        try:
            # Connect the socket here, so that no proxy of the environment is used between harness and policy.
            sock = line or socket.create_connection((host, port), timeout=deadline_s)
        except TimeoutError:
            raise UnreachableError("timeout", f"{place} took no connection within {deadline_s:.3g} s") from None
        except ConnectionRefusedError:
            raise UnreachableError(
                "start", f"nothing listens at {place}; start the policy's server there first"
            ) from None
        except OSError as error:
            raise UnreachableError("start", f"no connection to {place}: {error.strerror or error}") from None
        sock.settimeout(None)
        try:
            deadline = Deadline(sock)
        except RuntimeError as error:
            sock.close()
            raise ExhaustedError(f"no thread for the connection to {place}: {error}") from None
        with deadline.within(until - time.monotonic()):
            try:
                with ExitStack() as stack:
                    opened = stack.enter_context(_opened(f"ws://{place}{path}", sock, authorization, until))
                    connection = cls(opened, deadline)
                    connection._stack = stack.pop_all()
                    return connection
            except Exception as error:
                deadline.end()
                if isinstance(error, TimeoutError) or deadline.expired:
                    text = f"no answer to the WebSocket handshake within {deadline_s:.3g} s"
                    raise PolicyError("timeout", text) from None
                if is_exhausted(error):  # In this process; the server has no part in it.
                    sock.close()
                    raise ExhaustedError(f"no thread for the connection to {place}: {error}") from None
                if gone := absent(error):
                    raise UnreachableError("start", f"no policy server answers at {place}: {gone}") from None
                # Beside its own classes websockets raises AssertionError for some bytes that are not HTTP.
                why = f"{type(error).__name__}: {error}"
                raise PolicyError(
                    "handshake", f"the WebSocket handshake with the policy server failed: {why:.300}"
                ) from None

    def waiting(self, *, deadline_s: float = CLOSE_S) -> bytes | str | None:
        """Return a frame that has already come; None if there is none."""
        try:
            with self._deadline.within(deadline_s):
                return self._websocket.recv(timeout=0)
        except Exception:
            # Nothing has come, as expected; or the line is closed, which the next request will report.
            return None

    def expect_silence(self, *, deadline_s: float = CLOSE_S) -> None:
        """Raise PolicyError if a frame has already come: it would answer an observation that was not sent yet."""
        if (frame := self.waiting(deadline_s=deadline_s)) is not None:
            raise PolicyError("garbage", f"expected no message before the next request, got one of {len(frame)} bytes")

    def send(self, message: bytes, *, deadline_s: float) -> None:
        """Send a message. For a peer that does not read, closing our end of the line at the deadline ends the wait."""
        self._sent_bytes = len(message)
        with self._deadline.within(deadline_s) as deadline:
            try:
                self._websocket.send(message)
            except Exception as error:
                if deadline.expired:
                    raise PolicyError("timeout", f"did not read its message within {deadline_s:.2g} s") from None
                raise closed(error, sent_bytes=self._sent_bytes) from None
        if self.on_sent is not None:
            self.on_sent(message)

    def receive(self, what: str, *, deadline_s: float, late: str = "") -> bytes | str:
        """Return the next frame, of at most MAX_REPLY_BYTES. Raises PolicyError ``timeout``, with ``late`` appended,
        ``oversize``, ``garbage`` or ``died``."""
        deadline_s = max(deadline_s, 0.0)
        with self._deadline.within(deadline_s) as deadline:
            try:
                # Cut the line to end the wait: only after it is closed does websockets report why it gave the line up.
                frame = self._websocket.recv(timeout=deadline_s + CLOSE_S)
            except Exception as error:
                failure = closed(error, sent_bytes=self._sent_bytes)
                if failure.kind == "died" and deadline.expired:
                    raise PolicyError("timeout", f"no {what} message within {deadline_s:.3g} s{late}") from None
                raise failure from None
        if self.on_received is not None:
            self.on_received(frame)
        return frame

    def ask(self, message: bytes, what: str, *, deadline_s: float) -> bytes | str:
        """Send a message and receive its answer, both within one deadline; nothing may have come before."""
        until = time.monotonic() + deadline_s
        self.expect_silence(deadline_s=deadline_s)
        self.send(message, deadline_s=until - time.monotonic())
        try:
            return self.receive(what, deadline_s=until - time.monotonic())
        except PolicyError as error:
            if error.kind != "timeout":
                raise
            raise PolicyError("timeout", f"no {what} message within {deadline_s:.3g} s") from None

    def close(self) -> None:
        """Close the connection within CLOSE_S, whether or not the other end answers."""
        try:
            with self._deadline.within(CLOSE_S):
                self._stack.close()
        finally:
            self._deadline.end()


def _opened(uri: str, sock: socket.socket, authorization: str, until: float) -> ClientConnection:
    return connect(
        uri,
        sock=sock,
        additional_headers={"Authorization": authorization} if authorization else None,
        compression=None,
        ping_interval=None,
        logger=_UNHEARD,
        max_size=MAX_REPLY_BYTES,
        max_queue=MAX_UNREAD_FRAMES,
        open_timeout=max(until - time.monotonic(), 0.0),
        close_timeout=CLOSE_S,
    )


class Deadline:
    """A thread that shuts a line down at the deadline of a call, whatever blocks on it.

    The deadlines of websockets do not hold against a peer that does not read. Its receiving thread answers pings, and
    while it waits to send a pong it keeps the lock that sending and closing need.
    """

    def __init__(self, line: socket.socket) -> None:
        """Raises RuntimeError if no thread can be started."""
        self.expired = False
        self._line, self._changed = line, threading.Condition()
        self._until, self._wakes = math.inf, math.inf
        self._over = False
        threading.Thread(target=self._watch, daemon=True).start()

    @contextmanager
    def within(self, deadline_s: float) -> Generator[Self]:
        """Cut the line if the block takes longer than ``deadline_s`` [s]; ``expired`` then is true."""
        with self._changed:
            self._until = time.monotonic() + max(deadline_s, 0.0)
            if self._until < self._wakes:
                self._changed.notify()
        try:
            yield self
        finally:
            with self._changed:
                self._until = math.inf

    def end(self) -> None:
        with self._changed:
            self._over = True
            self._changed.notify()

    def _watch(self) -> None:
        with self._changed:
            while not self._over:
                left_s = self._until - time.monotonic()
                if left_s <= 0.0:
                    self.expired, self._until = True, math.inf
                    with suppress(OSError):
                        self._line.shutdown(socket.SHUT_RDWR)
                    continue
                self._wakes = self._until
                self._changed.wait(min(left_s, threading.TIMEOUT_MAX))
