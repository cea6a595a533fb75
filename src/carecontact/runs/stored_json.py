"""Reads JSON of a run's folder, which may come from a stranger, in bounded memory."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any

from carecontact.errors import ConfigError

MAX_BYTES = 128 << 20
"""Largest size of unpacked scores. A trial has 6 kB."""
MAX_CONTAINERS, MAX_VALUES = 1_000_000, 4_000_000
"""Most lists and objects, and most values, of one file: as many as scores of the largest size have (30 and 170 for each
trial). In Python, an empty list takes thirty times as much memory as in a file."""


def read_bounded(path: Path, *, most: int = MAX_BYTES) -> bytes:
    """Return the content of a file.

    Raises ConfigError for one that is larger than ``most`` [bytes], or that is no file, such as a pipe, whose reader
    would wait; OSError for one that cannot be read.
    """
    with open(path, "rb", opener=_at_once) as file:
        regular = stat.S_ISREG(os.fstat(file.fileno()).st_mode)
        content = file.read(most + 1) if regular else b""
    if not regular:
        raise ConfigError(f"{path} is not a file that can hold the results of a run")
    if len(content) > most:
        raise ConfigError(f"{path} has more than the {most >> 20} MB that it may have")
    return content


def parse(text: bytes) -> Any:
    """Return what JSON holds.

    Raises ValueError for text that is not JSON, or that holds more lists, objects or values, or nests deeper, than the
    files of a run do.
    """
    # Brackets and commas inside of strings count as well: there are few.
    if text.count(b"[") + text.count(b"{") > MAX_CONTAINERS or text.count(b",") > MAX_VALUES:
        raise ValueError("it holds more values than a run can have")
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _at_once(path: str, flags: int) -> int:
    """Open without waiting for the other end of a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
