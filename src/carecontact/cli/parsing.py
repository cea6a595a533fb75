"""The commands of ``carecontact``, the parser that turns a command line into one of them, their help texts, and what a
misspelt one may have meant."""

from __future__ import annotations

import ast
import inspect
import io
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Annotated, Any, ClassVar, Protocol, get_args, get_origin, get_type_hints

import tyro

from carecontact.errors import ConfigError, did_you_mean

# What ``--help`` says of an option: its docstring as one paragraph, and its default only where that says something.


@cache
def described(command: type[Any]) -> type[Any]:
    """Return the command, or a group of options, with help texts that tyro prints unchanged. A class is changed only
    once."""
    for owner in reversed(command.__mro__):
        if is_dataclass(owner) and isinstance(owner, type):
            _describe(owner)
    return command


def option_names(command: type[Any]) -> list[str]:
    """Return every option of a command as it is typed, including those of its groups. Positional arguments are left
    out."""
    names: list[str] = []
    for field, hint in _options(command):
        if is_dataclass(_bare(hint)):
            names += option_names(_bare(hint))
        elif tyro.conf.Positional not in get_args(hint)[1:]:
            named = [extra.name for extra in get_args(hint)[1:] if getattr(extra, "name", None)]
            names.append(f"--{(named or [field.name])[0].replace('_', '-')}")
    return names


def positional_names(command: type[Any]) -> list[str]:
    """Return the fields of a command that are typed without an option."""
    return [field.name for field, hint in _options(command) if tyro.conf.Positional in get_args(hint)[1:]]


def _describe(owner: type[Any]) -> None:
    docs = _docstrings(owner)
    own = inspect.get_annotations(owner)
    for field, hint in _options(owner):
        if is_dataclass(_bare(hint)):
            described(_bare(hint))
        elif field.name in own and field.name in docs:
            owner.__annotations__[field.name] = Annotated[hint, _text(docs[field.name], _default(field))]


def _text(docstring: str, default: object) -> Any:
    text = " ".join(docstring.split())
    if default is MISSING:
        return tyro.conf.arg(help=text, help_behavior_hint="(required)")
    if default is None or default is False or default == ():
        return tyro.conf.arg(help=text, help_behavior_hint="")
    return tyro.conf.arg(help=text)


def _default(field: Field[Any]) -> object:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _options(owner: type[Any]) -> Iterator[tuple[Field[Any], Any]]:
    hints = get_type_hints(owner, include_extras=True)
    for field in fields(owner):
        yield field, hints[field.name]


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


@cache
def _parsed(module: ModuleType) -> ast.Module:
    return ast.parse(inspect.getsource(module))


def _docstrings(owner: type[Any]) -> dict[str, str]:
    """Return each field -> the docstring under it. The class must be at the top level of its module."""
    made = next(
        node for node in _parsed(sys.modules[owner.__module__]).body
        if isinstance(node, ast.ClassDef) and node.name == owner.__name__
    )  # fmt: skip
    found: dict[str, str] = {}
    for node, after in zip(made.body, made.body[1:], strict=False):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and isinstance(after, ast.Expr):
            if isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
                found[node.target.id] = after.value.value
    return found


# Commands and options as users type them: synonyms, and what a misspelt one may have meant.

SYNONYMS = {
    "run": {"--task": "--tasks", "--seed": "--seeds"},
    "compare": {"--null": "--baseline"},
    "report": {"--null": "--baseline"},
}
"""Command -> option that it understands -> the option that its help shows."""


def with_synonyms(arguments: Sequence[str]) -> list[str]:
    """Return the command line with the names of options that the help shows."""
    if not arguments:
        return []
    if arguments[0] == "help":
        return [*arguments[1:], "--help"]
    known = SYNONYMS.get(arguments[0], {})
    split = [argument.partition("=") for argument in arguments]
    return [known.get(name, name) + equals + value for name, equals, value in split]


def unknown_command(name: str, commands: Iterable[str]) -> str:
    valid = list(commands)
    return f"no command named {name!r}{did_you_mean(name, valid)}; valid: {', '.join(valid)}"


def unknown_option(name: str, command: type[Any], arguments: Iterable[str]) -> str | None:
    """Return a message about the first option that a command does not have, or None if it has all of them."""
    valid = option_names(command)
    for argument in arguments:
        option = argument.partition("=")[0]
        if option.startswith("--") and option.replace("_", "-") not in ("--", "--help", *valid):
            meant = _option_meant(option, command)
            return f"{name} has no option {option}{meant}; `carecontact {name} --help` shows all options"
    return None


def _option_meant(option: str, command: type[Any]) -> str:
    """Return the option that was meant. The dashes, which all options share, do not count, and the name of a positional
    argument is never meant."""
    bare = option.removeprefix("--").replace("_", "-")
    if bare in positional_names(command):
        return f"; give the {bare} without {option}"
    meant = did_you_mean(bare, [valid.removeprefix("--") for valid in ("--help", *option_names(command))])
    return meant.replace("mean '", "mean '--")


# Makes one line of what the parser prints about a wrong command line.

NOT_OF_TYPE = re.compile(r"no type matching (\S+) could be instantiated from \[(.*?)\]")
NO_NUMBER = re.compile(r"(?:invalid literal for (int)\(\) with base 10|could not convert string to (float)): ('.*?')")
NO_CHOICE = re.compile(r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of \((.*?)\)")
RULE = re.compile(r"─{8,}|-{8,}")
"""The parser's words, as tyro writes them, and its rules with and without UTF-8."""
LISTED = re.compile(r"T\d+|\d+")
"""A word that looks like a task or a seed."""
MISSING_OPTION, UNRECOGNIZED = "Missing from carecontact ", "Unrecognized options: "


def in_one_line(box: str) -> str:
    """Return what is wrong and where help is from tyro's framed page, without the indented help texts."""
    rows = [line.strip("│╰╯ \n") for line in box.splitlines() if not line.startswith(" " * 8, 2)]
    sections = [" ".join(section.split()) for section in RULE.split("\n".join(rows[1:])) if section.strip()]
    if not sections:
        return " ".join(box.split())
    first = sections[0].removeprefix("Error parsing ").partition(" Got errors:")[0]
    first = NOT_OF_TYPE.sub(r"expected \1, got \2", first)
    first = NO_NUMBER.sub(lambda found: f"expected {(found[1] or found[2]).upper()}, got {found[3]}", first)
    first = NO_CHOICE.sub(_no_choice, first.rstrip("."))
    help_is = [section for section in sections[1:] if section.startswith("For full helptext")]
    stray = next((section for section in sections if section.startswith(UNRECOGNIZED)), None)
    if stray is None:
        return "; ".join([first, *help_is])
    told = _stray(stray.removeprefix(UNRECOGNIZED).split(), re.findall(r"(--\S+) [A-Z]", first))
    return "; ".join([told, *([first] if first.startswith(MISSING_OPTION) else []), *help_is])


def _stray(words: Sequence[str], missing: Sequence[str]) -> str:
    """Describe words that no option takes. The first of them may be values whose options are missing."""
    meant = " ".join(f"{option} {word}" for option, word in zip(missing, words, strict=False))
    if not meant and all(LISTED.fullmatch(word) for word in words):
        meant = "a list with commas, such as --tasks T1,T2 or --seeds 0,1"
    return f"no option takes {' '.join(words)}" + (f" (did you mean {meant}?)" if meant else "")


def _no_choice(found: re.Match[str]) -> str:
    given, argument, listed = found.groups()
    valid = [choice for choice in re.findall(r"'(.*?)'", listed) if choice != "None"]
    place = f"{argument}: " if argument.startswith("-") else ""
    return f"{place}no choice named {given!r}{did_you_mean(given, valid)}; valid: {', '.join(valid)}"


# The commands of ``carecontact``, and the parser that turns a command line into one of them.


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
    "merge": "sweep:Merge",
    "salt": "audit:Salt",
    "sweep": "sweep:Sweep",
    "check": "check:Check",
    "serve": "serve:Serve",
    "demo": "run:Demo",
    "score": "score:Score",
    "report": "report:Report",
    "compare": "compare:Compare",
    "paper": "export:Paper",
    "export": "export:Export",
    "video": "video:Video",
    "view": "video:View",
    "validate": "validate:Validate",
    "calibrate": "calibrate:Calibrate",
    "look": "check:Look",
    "audit": "audit:Audit",
    "notes": "video:Notes",
    "probe": "validate:Probe",
    "protocol": "protocol:Protocols",
    "list": "names:List",
    "doctor": "check:Doctor",
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
