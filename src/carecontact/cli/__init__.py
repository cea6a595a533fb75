"""The ``carecontact`` command, one file per command: it parses, calls and prints."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Sequence

from carecontact import __version__
from carecontact.errors import CarecontactError, ConfigError

REPEATABLE = ("--set", "--policy-arg", "--policy-env")
"""Options that a command line may hold several times."""
INTERRUPTED, BROKEN_PIPE = 130, 141
"""128 and the signal's number, as a shell counts."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; returns its exit status. Errors that the user can fix give one message and status 2."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A name out of a file or of a policy may hold what no terminal can show.
        sys.stdout.reconfigure(errors="backslashreplace")
    if arguments == ["--version"]:
        print(f"carecontact {__version__}")
        return 0
    from carecontact.cli.commands import parse
    from carecontact.cli.spelling import with_synonyms

    # A polite kill must stop the trials' processes as Ctrl-C does; they live in sessions of their own.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    left = ""
    try:
        _readable(arguments)
        arguments = with_synonyms(arguments)
        _once(arguments)
        command = parse(arguments)
        left = command.after_interrupt
        status = command()
        print(end="", flush=True)
        return status
    except CarecontactError as error:
        print(_error_line(str(error)), file=sys.stderr)
        return 2
    except BrokenPipeError:
        # Whoever read the output has gone; what is still buffered must not be tried again while Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        from carecontact.recording.storage import REMEDY, is_full

        place = error.filename2 or error.filename
        told = f"{place}: {error.strerror}" if place and error.strerror else str(error)
        print(_error_line(f"{told}; {REMEDY}" if is_full(error) else told), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\ninterrupted{left}", file=sys.stderr)
        return INTERRUPTED


def _readable(arguments: Sequence[str]) -> None:
    """Refuse a name that is no text: recordings, reports and messages could not hold it. Raises ConfigError."""
    for text in (*arguments, os.getcwd()):
        try:
            text.encode()
        except UnicodeEncodeError:
            what = "argument" if text in arguments else "name of the current folder"
            raise ConfigError(f"the {what} {text!a} holds bytes that are not UTF-8; rename it") from None


def _once(arguments: Sequence[str]) -> None:
    """Refuse a repeated option, of which the parser would silently keep the last. Raises ConfigError naming it."""
    options = [argument.partition("=")[0] for argument in arguments if argument.startswith("--")]
    options = [option for option in options if option.replace("_", "-") not in REPEATABLE]
    twice = next((option for option in options if options.count(option) > 1), None)
    if twice:
        raise ConfigError(f"{twice} is given twice; give it once, followed by all of its values as --help shows")


def _error_line(message: str) -> str:
    if sys.stderr.isatty() and not os.environ.get("NO_COLOR"):
        return f"\x1b[31merror: {message}\x1b[0m"
    return f"error: {message}"
