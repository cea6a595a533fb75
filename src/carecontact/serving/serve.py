"""Serves a policy of this host to trials elsewhere: on other hosts, where each connection gets a policy process of its
own as a local trial does, or in other processes, where all share an object of this process."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from websockets.sync.server import ServerConnection, serve

from carecontact.errors import CarecontactError, ConfigError
from carecontact.interface.policy import Policy
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import TOO_MANY_FILES, PolicyProcess
from carecontact.serving.server import OPTIONS, converse

HOST = "127.0.0.1"
"""Where an object of this process is served."""
FIRST_BYTE_S = 10.0
"""Time [s] for a client to send the first byte of its handshake; an honest one sends it at once."""
LOAD_DEADLINE_S = 600.0
"""Time [s] for a policy to load; the trial at the other end has a shorter deadline of its own."""
PAUSE_S = 1.0
KEEPALIVE_S = 60
"""Interval [s] of the checks whether a trial's host is still there; one that vanished is given up after about twice
this."""


def serve_trials(
    setup: PolicySetup,
    *,
    host: str,
    port: int,
    at_once: int,
    on_port: Callable[[int], None],
    on_event: Callable[[str], None],
) -> NoReturn:
    """Serve until the process ends. ``on_port`` is called with the port once the server listens, ``on_event`` with a
    line about each trial, from several threads. Raises ConfigError if the server cannot listen."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        raise ConfigError(f"cannot listen on {host}, port {port}: {error.strerror or error}") from None
    slots = threading.Semaphore(at_once)

    def serve_one(connection: socket.socket, peer: str) -> None:
        with connection:
            # A silent client takes no place, and for one that has left meanwhile no policy is started.
            if not _first_byte(connection):
                on_event(f"{peer}: it connected and sent nothing")
                return
            with slots:
                if not _left(connection):
                    _serve_one(connection, peer, setup=setup, on_event=on_event)

    with listener:
        on_port(listener.getsockname()[1])
        while True:
            try:
                connection, (address, number, *_) = listener.accept()
            except OSError as error:
                if error.errno not in TOO_MANY_FILES:
                    raise
                on_event(f"no connection is accepted for {PAUSE_S:g} s: {error.strerror}")
                time.sleep(PAUSE_S)
                continue
            # A daemon thread: when this process ends, the policies end too, by the pipe that they watch.
            threading.Thread(target=serve_one, args=(connection, f"{address} port {number}"), daemon=True).start()


def _first_byte(connection: socket.socket) -> bool:
    """Wait for the first byte of a connection, and leave it there; return False if none comes."""
    connection.settimeout(FIRST_BYTE_S)
    try:
        return bool(connection.recv(1, socket.MSG_PEEK))
    except OSError:
        return False
    finally:
        connection.settimeout(None)


def _left(connection: socket.socket) -> bool:
    """Whether the other end has closed its connection; False on systems that cannot say."""
    poll = select.poll()
    poll.register(connection, getattr(select, "POLLRDHUP", 0))
    return bool(poll.poll(0))


def _serve_one(connection: socket.socket, peer: str, *, setup: PolicySetup, on_event: Callable[[str], None]) -> None:
    on_event(f"{peer}: a trial begins")
    process = PolicyProcess(setup, first_deadline_s=LOAD_DEADLINE_S, deadline_s=LOAD_DEADLINE_S)
    try:
        with process, process.launch() as inner:
            _relay(connection, inner)
            where = process.hung()
    except (CarecontactError, OSError) as error:
        on_event(f"{peer}: {error}")
        return
    printed = f"; the policy printed last:\n{process.printed}" if process.printed else ""
    on_event(f"{peer}: the trial has ended{where}{printed}")


def _relay(outer: socket.socket, inner: socket.socket) -> None:
    """Pass bytes both ways until one end closes."""
    for one in (outer, inner):
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    outer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    outer.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEPALIVE_S)
    outer.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEPALIVE_S // 6)
    back = threading.Thread(target=_pump, args=(inner, outer), daemon=True)
    back.start()
    _pump(outer, inner)
    back.join()


def _pump(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError):
        while piece := source.recv(1 << 16):
            sink.sendall(piece)
    # If either end is gone, both are closed; what was sent before still arrives.
    for one in (source, sink):
        with suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)


@contextmanager
def served(policy: Policy, *, port: int) -> Iterator[str]:
    """Yield the address at which trials reach the policy, one at a time, until the block ends.

    The policy's methods are called in threads of this process. It is not isolated. Port 0 chooses a free one. Raises
    ConfigError if the server cannot listen.
    """
    turn = threading.Lock()

    def one_trial(connection: ServerConnection) -> None:
        with turn:
            converse(policy, connection, {}, ())

    try:
        server = serve(one_trial, HOST, port, **OPTIONS)
    except OSError as error:
        why = error.strerror or error
        raise ConfigError(f"cannot listen on {HOST}, port {port}: {why}; give another port") from None
    with server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"ws://{HOST}:{server.socket.getsockname()[1]}"
