"""The ``carecontact`` command: parses options, calls the packages, and prints what they return."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from carecontact import __version__
from carecontact.cli.console import drop_if_gone, drop_output, prepare_streams
from carecontact.errors import CarecontactError, ConfigError

REPEATABLE = ("--set", "--policy-arg", "--policy-env", "--policy-read", "--policy-write", "--tissue", "--region")
"""Options that a command line may hold several times."""
STOPPING = ("SIGTERM", "SIGHUP", "SIGQUIT")
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
    from carecontact.cli.console import OPTION, only_json

    as_json = OPTION in arguments
    command = _Command()
    try:
        with only_json(as_json):
            return command.run(arguments)
    except CarecontactError as error:
        print(_error_line(str(error)), file=sys.stderr)
        return _ended(as_json, type(error).__name__, str(error), 2)
    except OSError as error:
        from carecontact.recording.file import REMEDY, is_full

        place = error.filename2 or error.filename or ("standard output or a file" if is_full(error) else None)
        told = f"{place}: {error.strerror}" if place and error.strerror else str(error)
        told = f"{told}; {REMEDY}" if is_full(error) else told
        print(_error_line(told), file=sys.stderr)
        return _ended(as_json, type(error).__name__, told, 2)
    except (ImportError, AttributeError, RuntimeError) as error:
        if _module_of(error) not in ("mujoco", "OpenGL"):
            raise
        from carecontact.sim.opengl import choose_backend

        told = f"OpenGL: {error}; `carecontact doctor` says what is wrong"
        try:
            choose_backend()
        except CarecontactError as better:
            told = str(better)
        print(_error_line(told), file=sys.stderr)
        return _ended(as_json, "DependencyError", told, 2)
    except KeyboardInterrupt:
        print(f"\ninterrupted{command.left}", file=sys.stderr)
        return _ended(as_json, "Interrupted", f"interrupted{command.left}", INTERRUPTED)


class _Command:
    """One command line that is parsed and called."""

    left = ""
    """What an interruption leaves behind, once that is known."""

    def run(self, arguments: Sequence[str]) -> int:
        from carecontact.cli.parsing import parse, with_synonyms

        _stop_as_interrupted()
        _readable(arguments)
        arguments = with_synonyms(arguments)
        _once(arguments)
        command = parse(arguments)
        self.left = command.after_interrupt
        status = command()
        print(end="", flush=True)
        return status


def _module_of(error: BaseException) -> str:
    """Return the name of the top package in whose code an error was raised. MuJoCo and PyOpenGL cannot be imported
    where a variable names a backend that is not there."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return "" if place is None else str(place.tb_frame.f_globals.get("__name__")).partition(".")[0]


def _ended(as_json: bool, error: str, message: str, status: int) -> int:
    """Tell a program that reads JSON why the command ended, and return the exit status."""
    from carecontact.cli.console import print_error

    try:
        if as_json:
            print_error(error, message, status)
    except OSError:  # Standard output is full, of which standard error has already told.
        drop_output(sys.stdout.fileno())
    return status


def _readable(arguments: Sequence[str]) -> None:
    """Raises ConfigError for a name that is not valid text, which no recording, report or message could hold."""
    for text in (*arguments, os.getcwd()):
        try:
            text.encode()
        except UnicodeEncodeError:
            what = "argument" if text in arguments else "name of the current folder"
            raise ConfigError(f"the {what} {text!a} holds bytes that are not UTF-8; rename it") from None


def _stop_as_interrupted() -> None:
    """Let SIGTERM and a closed terminal stop the trials' processes, which live in sessions of their own, as Ctrl-C
    does.

    What the caller ignores, as nohup does, stays ignored.
    """
    for number in _stopping():
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    # A closed terminal tells it twice, and the second time must not interrupt the cleaning up. Ctrl-C still may.
    for each in _stopping():
        signal.signal(each, signal.SIG_IGN)
    for stream in (sys.__stdout__, sys.__stderr__):
        drop_if_gone(stream)
    raise KeyboardInterrupt


def _stopping() -> list[signal.Signals]:
    return [number for name in STOPPING if (number := getattr(signal, name, None)) is not None]


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
