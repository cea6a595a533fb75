"""Standard output and standard error of a command whose terminal or reader may be absent, or go away."""

from __future__ import annotations

import errno
import io
import os
import select
import sys
from typing import TYPE_CHECKING, TextIO, cast

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


def prepare_streams() -> None:
    """Make both streams usable to the command's end. Call this before any file is opened."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = cast("TextIO | None", getattr(sys, name))
        if stream is None:
            # Otherwise, the next file that is opened gets its number, and what libraries print goes into that file.
            setattr(sys, name, open(os.devnull, "w"))
        elif isinstance(stream, io.TextIOWrapper):
            if stream.isatty():
                terminal = io.BufferedWriter(_Terminal(number, "w", closefd=False))
                stream = io.TextIOWrapper(terminal, encoding=stream.encoding, line_buffering=True)
                setattr(sys, name, stream)
            # A name out of a file or of a policy may hold what no terminal can show.
            stream.reconfigure(errors="backslashreplace")


class _Terminal(io.FileIO):
    """A terminal. Once it is closed, further output is dropped, so that a run that was disowned goes on."""

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            drop_output(self.fileno())
            return memoryview(data).nbytes


def drop_output(number: int) -> None:
    """Let a file descriptor lead nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), number)


def drop_if_gone(stream: TextIO | None) -> None:
    """Drop further output if the terminal is gone or nobody reads the pipe any more, so that printing does not fail.

    The function asks the system and writes nothing, because a terminal that is full and not read would keep the writer
    waiting."""
    if stream is None:
        return
    watch = select.poll()
    # Without any event asked for, only hang-ups and errors are told.
    watch.register(stream.fileno(), 0)
    if watch.poll(0):
        drop_output(stream.fileno())
