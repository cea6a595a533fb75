"""Progress of a video: one line that is rewritten on a terminal, and elsewhere a new line every 30 s."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")
TERMINAL_S, PLAIN_S = 0.25, 30.0
"""Time between two lines, on a terminal and elsewhere."""


def counted(items: Iterable[T], total: int, name: str) -> Iterator[T]:
    """Yield the items, and print how many of ``total`` there have been and how much time is left."""
    began = told = time.monotonic()
    terminal = sys.stdout.isatty()
    for number, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if now - told >= (TERMINAL_S if terminal else PLAIN_S):
            told = now
            left_s = (now - began) / number * (total - number)
            line = f"{name}: frame {number} of {total}, {left_s:.0f} s left"
            print(f"\r{line:<70}" if terminal else line, end="" if terminal else "\n", flush=True)
    if terminal:
        print(f"\r{'':<70}\r", end="", flush=True)
