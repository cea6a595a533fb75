"""The ``carecontact`` command: parses options, calls the packages, and prints what they return."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from carecontact import __version__
from carecontact.cli import console
from carecontact.cli.console import OPTION, drop_if_gone, drop_output, only_json, prepare_streams, print_error
from carecontact.errors import CarecontactError, ConfigError

REPEATABLE = ("--set", "--policy-arg", "--policy-env", "--policy-read", "--policy-write", "--tissue", "--region")
"""Options that a command line may hold several times."""
STOPPING = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
INTERRUPTED = 130
"""Exit status after SIGINT: 128 plus the signal's number, as shells count."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit status. Errors that the user can fix give one message and status 2."""
    if arguments is None:
        arguments = sys.argv[1:]
        # The program that started this command may ignore SIGCHLD. The kernel would then report no exit status.
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    arguments = list(arguments)
    prepare_streams()
    if arguments == ["--version"]:
        print(f"carecontact {__version__}")
        return 0
    as_json = OPTION in arguments
    command = None
    try:
        with only_json(as_json):
            from carecontact.cli.parsing import parse

            _stop_as_interrupted()
            _check_text(arguments)
            _check_repeated(arguments)
            console.typed[:] = arguments
            command = parse(arguments)
            status = command()
            print(end="", flush=True)
            return status
    except CarecontactError as error:
        return _fail(as_json, type(error).__name__, str(error))
    except OSError as error:
        from carecontact.recording.file import REMEDY, is_full

        place = error.filename2 or error.filename or ("standard output or a file" if is_full(error) else None)
        message = f"{place}: {error.strerror}" if place and error.strerror else str(error)
        return _fail(as_json, type(error).__name__, f"{message}; {REMEDY}" if is_full(error) else message)
    except (ImportError, AttributeError, RuntimeError) as error:
        if _module_of(error) not in ("mujoco", "OpenGL"):
            raise
        from carecontact.sim.opengl import choose_backend

        message = f"OpenGL: {error}; `carecontact doctor` says what is wrong"
        try:
            choose_backend()
        except CarecontactError as better:
            message = str(better)
        return _fail(as_json, "DependencyError", message)
    except KeyboardInterrupt:
        message = "interrupted" + getattr(command, "after_interrupt", "")
        print(f"\n{message}", file=sys.stderr)
        return _end(as_json, "Interrupted", message, INTERRUPTED)


def _module_of(error: BaseException) -> str:
    """The top package that raised an error: MuJoCo and PyOpenGL raise one at import, for an unknown backend."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return "" if place is None else str(place.tb_frame.f_globals.get("__name__")).partition(".")[0]


def _fail(as_json: bool, error: str, message: str) -> int:
    red = sys.stderr.isatty() and not os.environ.get("NO_COLOR")
    print(f"\x1b[31merror: {message}\x1b[0m" if red else f"error: {message}", file=sys.stderr)
    return _end(as_json, error, message, 2)


def _end(as_json: bool, error: str, message: str, status: int) -> int:
    try:
        if as_json:
            print_error(error, message, status)
    except OSError:  # Standard output is full, as standard error says already.
        drop_output(sys.stdout.fileno())
    return status


def _check_text(arguments: Sequence[str]) -> None:
    """Raises ConfigError for a name that is not valid text, which no recording, report or message could hold."""
    for text in (*arguments, os.getcwd()):
        try:
            text.encode()
        except UnicodeEncodeError:
            what = "argument" if text in arguments else "name of the current folder"
            raise ConfigError(f"the {what} {text!a} holds bytes that are not UTF-8; rename it") from None


def _stop_as_interrupted() -> None:
    """Let SIGTERM and a closed terminal stop the trials as Ctrl-C does. What the caller ignores stays ignored."""
    for number in STOPPING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    # A closed terminal sends the signal twice, and the second must not interrupt the cleaning up. Ctrl-C still may.
    for each in STOPPING:
        signal.signal(each, signal.SIG_IGN)
    for stream in (sys.__stdout__, sys.__stderr__):
        drop_if_gone(stream)
    raise KeyboardInterrupt


def _check_repeated(arguments: Sequence[str]) -> None:
    """Raises ConfigError for a repeated option, of which the parser would silently keep the last."""
    options = [argument.partition("=")[0] for argument in arguments if argument.startswith("--")]
    options = [option for option in options if option.replace("_", "-") not in REPEATABLE]
    twice = next((option for option in options if options.count(option) > 1), None)
    if twice:
        raise ConfigError(f"{twice} is given twice; give it once, followed by all of its values as --help shows")
