"""One hard limit of wall time round anything that waits for others."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Value = TypeVar("Value")


def call_within(seconds: float, function: Callable[[], Value]) -> Value:
    """What ``function`` returns or raises, or TimeoutError once the time is up.

    It runs in a thread of its own, which is then left to itself: nothing else ends the look-up of a host's name, or a
    header that arrives byte by byte, each well within the timeout of a socket.
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
