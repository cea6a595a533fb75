"""Processes that draw the frames of a video at the same time, in the order of the video."""

from __future__ import annotations

import os
import pickle
import signal
from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from multiprocessing import get_context

from carecontact.errors import DependencyError
from carecontact.kernel import library
from carecontact.replaying.film.ink import Picture
from carecontact.replaying.film.painter import Moment, Painter, Picturing

AHEAD = 2
"""Number of batches that wait for each process, at most: enough that none idles, and few pictures in memory."""
THREADS = "LP_NUM_THREADS"
"""Environment variable with the number of threads of Mesa's software renderer; 0 draws in the calling thread."""

_what: Picturing | None = None
"""What all frames have in common, in a drawing process."""


def drawn(what: Picturing, batches: Iterable[list[Moment]], *, jobs: int) -> Generator[Picture, None, None]:
    """Yield the frames of all batches in their order.

    Args:
        jobs: number of processes that draw; 1 draws in this one.

    Raises:
        DependencyError: nothing can be rendered, or a drawing process was killed.
    """
    if jobs == 1:
        with Painter(what) as painter:
            for batch in batches:
                yield from painter.frames(batch)
        return
    # Processes are started anew: one that is forked after this one has rendered anything would wait for ever.
    sent = pickle.dumps(what)
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(sent,))
    waiting: deque[Future[list[Picture]]] = deque()
    try:
        for batch in batches:
            waiting.append(pool.submit(_draw, batch))
            if len(waiting) >= AHEAD * jobs:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()
    except BrokenProcessPool:
        raise DependencyError(
            "a process that draws the video was killed, perhaps for memory: try again with --jobs 1"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(sent: bytes) -> None:
    global _what
    # An interruption ends the process that waits for these, which then ends them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault(THREADS, "0")
    library.load()  # without which a model with soft tissue cannot be unpacked
    _what = pickle.loads(sent)


@cache
def _painter() -> Painter:
    assert _what is not None
    return Painter(_what)


def _draw(batch: list[Moment]) -> list[Picture]:
    return _painter().frames(batch)
