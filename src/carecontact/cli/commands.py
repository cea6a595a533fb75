"""The commands of ``carecontact``, and the parser that turns a command line into one of them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from importlib import import_module
from typing import Any, ClassVar, Protocol

import tyro

from carecontact.cli.option_texts import described
from carecontact.cli.spelling import unknown_command, unknown_option
from carecontact.cli.usage_text import in_one_line
from carecontact.errors import ConfigError


class Command(Protocol):
    """A dataclass of options. A call does the work and returns the exit status."""

    after_interrupt: ClassVar[str]
    """What Ctrl-C has left behind, as a continuation of the word "interrupted"."""

    def __call__(self) -> int: ...


class UsageError(ConfigError):
    """The command line names an option, a value or a command that does not exist."""


CONFIG = (tyro.conf.DisallowNone, tyro.conf.HelptextFromCommentsOff)
"""Settings of the parser. The help leaves out the default None, which nobody types. ``described`` gives the help texts,
so that tyro need not look for comments in the sources."""
COMMANDS = {
    "run": "run:Run",
    "merge": "merge:Merge",
    "salt": "salt:Salt",
    "sweep": "sweep:Sweep",
    "check": "check:Check",
    "serve": "serve:Serve",
    "demo": "demo:Demo",
    "score": "score:Score",
    "report": "report:Report",
    "compare": "compare:Compare",
    "paper": "paper:Paper",
    "export": "export:Export",
    "video": "video:Video",
    "view": "view:View",
    "validate": "validate:Validate",
    "calibrate": "calibrate:Calibrate",
    "look": "look:Look",
    "audit": "audit:Audit",
    "notes": "notes:Notes",
    "probe": "probe:Probe",
    "protocol": "protocol:Protocols",
    "list": "names:List",
    "doctor": "doctor:Doctor",
}
"""Name -> module of this package and class in it."""


def command_class(name: str) -> type[Any]:
    """Return the class of a command. Raises UsageError if no command has this name."""
    if name not in COMMANDS:
        raise UsageError(unknown_command(name, COMMANDS))
    module, _, made = COMMANDS[name].partition(":")
    return described(getattr(import_module(f"carecontact.cli.{module}"), made))


def parse(arguments: Sequence[str]) -> Command:
    """Return the command with its options, ready to call.

    Prints the help and exits if the arguments request it or are empty. Raises UsageError for wrong options.
    """
    errors = io.StringIO()
    if arguments and not arguments[0].startswith("-"):
        name, *options = arguments
        if wrong := unknown_option(name, command_class(name), options):
            raise UsageError(wrong)
    try:
        with redirect_stderr(errors):
            if arguments and arguments[0] in COMMANDS:
                name, *options = arguments
                return tyro.cli(command_class(name), prog=f"carecontact {name}", args=options, config=CONFIG)
            return tyro.extras.subcommand_cli_from_dict(
                {name: command_class(name) for name in COMMANDS},
                prog="carecontact",
                description="Measure whether a robot policy touches people well. `carecontact --version` prints the "
                "version.",
                args=list(arguments) or ["--help"],
                config=CONFIG,
            )
    except SystemExit as end:
        if end.code != 2:
            raise
        raise UsageError(in_one_line(errors.getvalue())) from None
