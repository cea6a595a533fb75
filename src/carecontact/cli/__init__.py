"""The ``carecontact`` command: parse, call, print. Everything heavy is imported by the command that needs it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence

from carecontact import __version__
from carecontact.errors import CarecontactError

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; returns its exit status. Errors a user can mend are one message and status 2."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments == ["--version"]:
        print(f"carecontact {__version__}")
        return 0
    from carecontact.cli.options import parse

    # A polite kill must stop the trials' processes as Ctrl-C does; they live in sessions of their own.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    command = parse(arguments)
    try:
        return command()
    except CarecontactError as error:
        print(_error_line(str(error)), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ninterrupted; finished trials are kept, the same command goes on from here", file=sys.stderr)
        return INTERRUPTED


def _error_line(message: str) -> str:
    if sys.stderr.isatty() and not os.environ.get("NO_COLOR"):
        return f"\x1b[31merror: {message}\x1b[0m"
    return f"error: {message}"
