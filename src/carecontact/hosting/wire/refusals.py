"""Error messages about a message or connection that the wire does not allow, with what to send instead."""

from __future__ import annotations

from collections.abc import Mapping

from websockets.exceptions import ConnectionClosed, InvalidStatus

from carecontact.errors import LostError, PolicyError, did_you_mean
from carecontact.hosting.wire.packing import MAX_REPLY_BYTES

EXAMPLES = {
    "card": '{"type": "card", "card": {"name": "my-policy", "modalities": ["rgb"], "cameras": ["overhead"]}}',
    "ready": '{"type": "ready"}',
    "actions": '{"type": "actions", "actions": [{"pose_tcp_in_base": [x, y, z, qw, qx, qy, qz]}]}',
}
"""Kind of message -> an example that a policy's server may send instead; docs/wire.md describes every message."""
LATE = {"card": "; a server sends its card first, unasked; if it serves one trial at a time, run with --jobs 1"}
"""Kind of message that did not come -> what may help."""
MESSAGE_TOO_BIG, PROTOCOL_ERROR, INVALID_DATA, INTERNAL_ERROR = 1009, 1002, 1007, 1011
GOING_AWAY, RESTART, TRY_AGAIN = 1001, 1012, 1013
"""Close codes of RFC 6455, section 7.4.1, and of IANA's registry of them."""
PROXY_ALONE = (502, 503, 504)
"""Statuses of HTTP: bad gateway, service unavailable, gateway timeout."""


def instead(kind: str) -> str:
    """Return what a policy's server may send as a message of this kind."""
    return f"send {EXAMPLES[kind]} as one binary message of msgpack (docs/wire.md)"


def wrong_keys(entries: Mapping[str, object], *, kind: str, field: str | None) -> str | None:
    """Return what is wrong with the keys of a message of type ``kind`` with one field; None if nothing is."""
    wanted = {"type"} | ({field} if field else set[str]())
    allowed = wanted | ({"notes"} if kind == "actions" else set[str]())
    unknown, missing = sorted(entries.keys() - allowed), sorted(wanted - entries.keys())
    if not unknown and not missing and entries["type"] == kind:
        return None
    unknown = [f"{name:.80}{did_you_mean(name, allowed)}" for name in unknown]
    keys = [f"{what} {', '.join(names)}" for what, names in (("unknown key", unknown), ("missing", missing)) if names]
    return "; ".join([f"type {entries.get('type')!r}", *keys])


def closed(error: Exception, *, sent_bytes: int) -> PolicyError:
    """Return why a call failed: a LostError where the server did not say so, or said that it starts anew.

    Args:
        error: ConnectionClosed, or the AssertionError of websockets when the peer vanishes in the middle of a call.
        sent_bytes: length of the last message to the policy.
    """
    sent = error.sent if isinstance(error, ConnectionClosed) else None
    received = error.rcvd if isinstance(error, ConnectionClosed) else None
    if received is not None and isinstance(error, ConnectionClosed) and error.rcvd_then_sent is not False:
        failure = LostError if received.code in (GOING_AWAY, RESTART, TRY_AGAIN) else PolicyError
        return failure("oversize" if received.code == MESSAGE_TOO_BIG else "died", _refused(received.code, sent_bytes))
    if sent is not None and sent.code == MESSAGE_TOO_BIG:
        return PolicyError("oversize", f"expected a reply of at most {MAX_REPLY_BYTES} bytes, got a longer one")
    if sent is not None and sent.code in (PROTOCOL_ERROR, INVALID_DATA):
        return PolicyError("garbage", f"the reply is not WebSocket: {sent.reason}")
    return LostError("died", "the connection closed without an answer")


def absent(error: Exception) -> str:
    """Return how a failed handshake shows that only a tunnel or proxy answered because the server behind it is away.

    Empty if a server answered.
    """
    if isinstance(error, InvalidStatus) and error.response.status_code in PROXY_ALONE:
        return f"a proxy there answers HTTP {error.response.status_code}"
    if isinstance(error, ConnectionResetError) or isinstance(error.__cause__, EOFError | ConnectionResetError):
        return "the connection was closed before the WebSocket handshake, as ssh -L does without a server behind it"
    return ""


def _refused(code: int, sent_bytes: int) -> str:
    """Return why the policy's server closed the connection, by the close code."""
    if code == MESSAGE_TOO_BIG:
        return (
            f"the policy's server refused a message of {sent_bytes} bytes (close code {code}): raise its limit, in "
            "Python's websockets with serve(..., max_size=None)"
        )
    if code == INTERNAL_ERROR:
        return (
            f"the policy's server raised an exception (close code {code}): see its own output; it may send an error "
            "message with the traceback instead (docs/wire.md). A common cause: msgpack cannot pack numpy's float32 or "
            "bool_; send plain numbers"
        )
    return f"the policy's server closed the connection without an answer (close code {code})"
