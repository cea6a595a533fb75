"""`--json`: standard output carries nothing but JSON, one object a line, and people read standard error."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from carecontact.cli.answers.answer import Answer

OPTION = "--json"
_output: TextIO | None = None


@contextlib.contextmanager
def only_json(wanted: bool) -> Iterator[None]:
    """Within the block, print to standard error, and let ``say`` alone write to standard output.

    Args:
        wanted: whether to do so; False leaves everything as it is.
    """
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


def say(answer: Answer) -> None:
    """Write one line without delay."""
    print(answer.line(), file=_output or sys.stdout, flush=True)


def say_error(error: str, message: str, status: int) -> None:
    """Write the last line of a command that an error ended. ``error``: class of the error."""
    from carecontact.cli.answers.error import ErrorAnswer

    say(ErrorAnswer(error=error, message=message, status=status))
