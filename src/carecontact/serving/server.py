"""The policy's end of the wire: one policy object, one connection, one conversation."""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from queue import SimpleQueue
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from carecontact.errors import ActionError, ContractError, LanguageError, PolicyError, ProgramError
from carecontact.interface.observation import LastViews
from carecontact.interface.policy import Policy, PolicyCard
from carecontact.serving import codec
from carecontact.serving.packing import MAX_MESSAGE_BYTES, MAX_REPLY_BYTES, is_map, pack, unpack
from carecontact.serving.process_tree import is_plumbing

TRACEBACK_CHARS = 2000
"""Most characters of a traceback or message: the whole of it might contain the policy's whole input."""
QUIET = logging.getLogger("carecontact.wire")
"""The log of the WebSocket library, which writes a traceback when a client misbehaves. That is no fault of the policy,
among whose output it would stand."""
QUIET.disabled = True
OPTIONS: dict[str, Any] = {
    "compression": None,
    "ping_interval": None,
    "max_size": MAX_MESSAGE_BYTES,
    "close_timeout": 1,
}
"""Of every WebSocket server of a policy."""
KINDS: dict[type[Exception], str] = {ActionError: "action", LanguageError: "language", ProgramError: "program"}
"""Exceptions whose message explains the failure: no line of the policy caused it, and a traceback would not help."""


def traceback_text(error: BaseException) -> str:
    """Return the traceback of an exception without the harness's own frames, in at most TRACEBACK_CHARS: the end of the
    stack and the beginning of the exception's message."""
    found = traceback.TracebackException.from_exception(error)
    _hide_plumbing(found)
    whole = "".join(found.format())
    if len(whole) <= TRACEBACK_CHARS:
        return whole
    last = "".join(found.format_exception_only())
    stack, half = whole.removesuffix(last), TRACEBACK_CHARS // 2
    if len(last) > half:
        last = f"{last[: half - 6]} [...]"
    return stack[-(TRACEBACK_CHARS - len(last)) :] + last


def _hide_plumbing(found: traceback.TracebackException) -> None:
    found.stack[:] = [frame for frame in found.stack if not is_plumbing(frame.filename)]
    for earlier in (found.__cause__, found.__context__, *(found.exceptions or ())):
        if earlier is not None:
            _hide_plumbing(earlier)


def serve_policy(
    policy: Policy,
    *,
    on_port: Callable[[int], None],
    client_port: int | None = None,
    arguments: Mapping[str, str] | None = None,
    environment: tuple[str, ...] = (),
) -> None:
    """Serve one client on the loopback interface until it closes; ``on_port`` is called with the port once it listens.

    ``client_port``: the only port from which a client may connect, since otherwise any process of the machine could
    take the policy's only connection; None accepts any port. ``arguments`` and ``environment`` are added to the card.

    The policy runs in the calling thread, because libraries for GPU, GUI and asyncio often require it.
    """
    offered: SimpleQueue[ServerConnection | Exception] = SimpleQueue()
    finished = threading.Event()

    def hand_over(connection: ServerConnection) -> None:
        with suppress(OSError):  # The client may have gone already.
            if client_port in (None, connection.remote_address[1]):
                offered.put(connection)
                finished.wait()

    def accept() -> None:
        try:
            server.serve_forever()
        except Exception as error:  # No thread for the connection, for example.
            offered.put(error)

    server = serve(hand_over, "127.0.0.1", 0, logger=QUIET, **OPTIONS)
    # Before the block, whose end waits for that thread.
    threading.Thread(target=accept, daemon=True).start()
    on_port(server.socket.getsockname()[1])
    connection = offered.get()
    if isinstance(connection, Exception):
        server.socket.close()
        raise connection
    with server:
        try:
            converse(policy, connection, arguments or {}, environment)
        finally:
            finished.set()


def converse(
    policy: Policy, connection: ServerConnection, arguments: Mapping[str, str], environment: tuple[str, ...]
) -> None:
    """Send the card and answer requests until the client closes or the policy fails, which the client learns."""
    try:
        card: object = getattr(policy, "card", None)
        if isinstance(card, PolicyCard):
            card = replace(
                card,
                arguments={**card.arguments, **arguments},
                environment=tuple(dict.fromkeys((*card.environment, *environment))),
            )
        connection.send(pack({"type": "card", "card": codec.encode_card(card)}))
        views = LastViews()
        for frame in connection:
            reply = _answer(policy, frame, views)
            if reply is None:
                return
            connection.send(pack(reply))
    except ConnectionClosed:
        return
    except PolicyError as error:
        _report(connection, policy, error.kind, str(error))
    except tuple(KINDS) as error:
        _report(connection, policy, KINDS[type(error)], str(error))
    except (Exception, SystemExit) as error:
        # Whatever a policy raises counts as its failure and must reach the harness; this server does not handle it.
        _report(connection, policy, "exception", traceback_text(error))


def _report(connection: ServerConnection, policy: Policy, kind: str, message: str) -> None:
    text = message[:TRACEBACK_CHARS].encode(errors="replace").decode()
    report: dict[str, object] = {"type": "error", "kind": kind, "message": text}
    # A policy that failed may also fail at its notes; the first failure is the one to report.
    packed = pack(report)
    with suppress(Exception):
        with_notes = pack(report | _notes(policy))
        packed = with_notes if len(with_notes) <= MAX_REPLY_BYTES else packed
    with suppress(ConnectionClosed):
        connection.send(packed)


def _notes(policy: Policy) -> dict[str, object]:
    take: Any = getattr(policy, "take_notes", None)
    notes = take() if take is not None else None
    return {"notes": notes} if notes else {}


def _answer(policy: Policy, frame: str | bytes, views: LastViews) -> dict[str, object] | None:
    message = unpack(frame) if isinstance(frame, bytes) else None
    entries = message if is_map(message) else {}
    kind, keys = entries.get("type"), entries.keys() - {"type"}
    if kind == "reset" and keys == {"instruction", "session"}:
        views.forget()
        configure: Any = getattr(policy, "configure", None)
        if configure is not None:
            configure(codec.decode_session(entries["session"]))
        policy.reset(str(entries["instruction"]))
        return {"type": "ready"}
    if kind == "act" and keys == {"observation"}:
        answer = policy.act(views.completed(codec.decode_observation(entries["observation"])))
        return {"type": "actions", "actions": codec.encode_actions(answer), **_notes(policy)}
    if kind == "close" and not keys:
        return None
    raise ContractError(
        f"message: expected a reset, act or close message, got type {kind!r:.80} with {sorted(keys)!s:.200}"
    )
