"""Serves a policy object of this process, on the loopback interface, to trials in other processes."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from websockets.sync.server import ServerConnection, serve

from carecontact.contract.policy import Policy
from carecontact.errors import ConfigError
from carecontact.hosting.wire.packing import MAX_MESSAGE_BYTES
from carecontact.hosting.wire.server import converse

HOST = "127.0.0.1"


@contextmanager
def served(policy: Policy, *, port: int) -> Iterator[str]:
    """Yield the address at which trials reach the policy; it is served until the block ends.

    One trial at a time talks to the policy, and the next one waits. The policy's methods are called in threads of this
    process. It is not isolated.

    Args:
        policy: an object with a card and the methods reset and act.
        port: port to listen on; 0 chooses a free one.

    Raises ConfigError if the server cannot listen.
    """
    turn = threading.Lock()

    def one_trial(connection: ServerConnection) -> None:
        with turn:
            converse(policy, connection, {}, ())

    try:
        server = serve(
            one_trial, HOST, port, compression=None, ping_interval=None, max_size=MAX_MESSAGE_BYTES, close_timeout=1
        )
    except OSError as error:
        raise ConfigError(
            f"cannot listen on {HOST}, port {port}: {error.strerror or error}; give another port"
        ) from None
    with server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"ws://{HOST}:{server.socket.getsockname()[1]}"
