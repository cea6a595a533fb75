"""Waits for file descriptors, whatever their numbers: ``select.select`` refuses those from 1024 on."""

from __future__ import annotations

import math
import select
from collections.abc import Iterable


def readable(descriptors: Iterable[int], timeout_s: float | None = None) -> list[int]:
    """Return the descriptors that have something to read, or have reached their end.

    Args:
        timeout_s: longest wait [s] for the first one; None waits until there is one.
    """
    watch = select.poll()
    for descriptor in descriptors:
        watch.register(descriptor, select.POLLIN)
    return [found for found, _ in watch.poll(None if timeout_s is None else math.ceil(max(timeout_s, 0.0) * 1e3))]
