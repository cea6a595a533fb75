"""A hard limit of wall time for anything that waits for others."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Value = TypeVar("Value")


def call_within(seconds: float, function: Callable[[], Value]) -> Value:
    """Return or raise what ``function`` does, or raise TimeoutError once the time is up.

    The function runs in a thread of its own, which is left to itself after the time limit: nothing else ends the
    look-up of a host's name, or a header that arrives byte by byte, each byte well within the timeout of a socket.
    """
    if seconds <= 0:
        raise TimeoutError
    answer: Future[Value] = Future()

    def work() -> None:
        try:
            answer.set_result(function())
        except BaseException as error:
            answer.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return answer.result(timeout=seconds)
