"""What every command prints with: streams, tables, lines of JSON, the command line itself, and the end of a policy's
failure."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import select
import shlex
import stat
import sys
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer
    from rich.console import Console
    from rich.table import Table

    from carecontact.cli.answers import Answer


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
    os.dup2(os.open(os.devnull, os.O_WRONLY), number)


def drop_if_gone(stream: TextIO | None) -> None:
    """Drop further output if no one reads it any more. Writing would wait at a terminal that is full and not read."""
    if stream is None:
        return
    watch = select.poll()
    # Without any event asked for, poll reports hang-ups and errors only.
    watch.register(stream.fileno(), 0)
    if watch.poll(0):
        drop_output(stream.fileno())


typed: list[str] = []
"""The command line, without the name of the program."""


def same_command(out: Path) -> str:
    """Return the command line that goes on with a run: without --restart and passwords, and with the chosen folder."""
    named = any(argument.partition("=")[0] == "--out" for argument in typed)
    kept = [without_secret(argument) for argument in typed if argument != "--restart"]
    return shlex.join(["carecontact", *kept, *([] if named else ["--out", str(out)])])


def without_secret(address: str) -> str:
    return re.sub(r"//[^/@]*@", "//", address)


def console(width: int = 140) -> Console:
    """Return a console as wide as the terminal or the variable COLUMNS says; ``width`` where neither does."""
    from rich.console import Console

    known = "COLUMNS" in os.environ or Console().is_terminal
    return Console(highlight=False, markup=False, width=None if known else width)


def plain_table(*headers: str, left: Collection[str] = ()) -> Table:
    """Return a table without lines. Its columns are flush right, except for the first and those in ``left``."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", title_justify="left", title_style="bold")
    for number, header in enumerate(headers):
        table.add_column(header, justify="left" if not number or header in left else "right")
    return table


def p_text(value: float | None) -> str:
    """Return a p-value with three decimals, or as a power of ten if it is small."""
    if value is None:
        return "NA"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"


# `--json`: standard output carries nothing but JSON, one object a line, and people read standard error.

OPTION = "--json"
_output: TextIO | None = None


@contextlib.contextmanager
def only_json(wanted: bool) -> Iterator[None]:
    """If ``wanted``, let ``print_answer`` alone write to standard output within the block."""
    global _output
    if not wanted:
        yield
        return
    _output = sys.stdout
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _output = None


def print_answer(answer: Answer) -> None:
    print(answer.line(), file=_output or sys.stdout, flush=True)


def print_error(error: str, message: str, status: int) -> None:
    from carecontact.cli.answers import ErrorAnswer

    print_answer(ErrorAnswer(error=error, message=message, status=status))


TRACE_LINES, PRINTED_LINES = 6, 4
"""Number of last lines of a traceback, and of what the policy printed, that are shown. The report has all lines."""


def excerpt(message: str) -> list[str]:
    """Return the end of the traceback or stack under a failure's first line, and of what the policy printed."""
    from carecontact.recording.reason import PRINTED, TRACEBACK
    from carecontact.serving.conversation import readable

    failure, _, printed = readable(message).partition(PRINTED)
    lines = _last(failure.splitlines()[1:], TRACE_LINES)
    if len([line for line in lines if line != TRACEBACK]) < 2:
        # Of a traceback that only had frames of ours, the exception alone is left: the reason, which stands above.
        lines = []
    if printed:
        lines += ["it printed last:", *_last(printed.splitlines(), PRINTED_LINES)]
    return [f"  | {line}" for line in lines]


def _last(lines: Sequence[str], most: int) -> list[str]:
    # Neither empty lines nor those in which a traceback only underlines.
    kept = [line for line in lines if line.strip(" ~^")]
    return kept if len(kept) <= most else ["...", *kept[-most:]]
