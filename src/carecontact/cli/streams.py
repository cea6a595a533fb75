"""Standard output and standard error of a command whose terminal or reader may be absent, or go away."""

from __future__ import annotations

import errno
import io
import os
import select
import stat
import sys
from typing import TYPE_CHECKING, TextIO, cast

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


GONE = (errno.EIO, errno.EPIPE, errno.ECONNRESET)
"""Errors of writing to a terminal, a pipe and a socket of which the other end is closed."""


def prepare_streams() -> None:
    """Make both streams usable to the command's end. Call this before any file is opened."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = cast("TextIO | None", getattr(sys, name))
        if stream is None:
            # Otherwise, the next file that is opened gets its number, and what libraries print goes into that file.
            setattr(sys, name, open(os.devnull, "w"))
        elif isinstance(stream, io.TextIOWrapper):
            if stream.isatty() or _is_piped(stream, number):
                stream.flush()  # What a program printed before it called this stays before it.
                output = io.BufferedWriter(_Output(number, "w", closefd=False))
                # At each line also where PYTHONUNBUFFERED is set.
                lines = stream.line_buffering or stream.write_through
                stream = io.TextIOWrapper(output, encoding=stream.encoding, line_buffering=lines)
                setattr(sys, name, stream)
            # A name out of a file or of a policy may hold what no terminal can show.
            stream.reconfigure(errors="backslashreplace")


def _is_piped(stream: TextIO, number: int) -> bool:
    """Return whether a stream still leads to its descriptor, and that to a pipe or a socket."""
    try:
        mode = os.fstat(stream.fileno()).st_mode
    except OSError:  # The stream leads to no descriptor: a test caught what is printed.
        return False
    return stream.fileno() == number and (stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode))


class _Output(io.FileIO):
    """A terminal, pipe or socket. Once it is closed at the other end, further output is dropped: what a command does
    and writes into files does not depend on who reads along, so that a disowned run and ``run | head`` go on."""

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in GONE:
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
