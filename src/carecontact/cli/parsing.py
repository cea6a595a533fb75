"""The commands of ``carecontact``, the parser that turns a command line into one of them, their help texts, and what a
misspelt one may have meant."""

from __future__ import annotations

import ast
import inspect
import io
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Annotated, Any, Protocol, get_args, get_origin, get_type_hints

import tyro

from carecontact.errors import ConfigError, did_you_mean


class Command(Protocol):
    """A dataclass of options. A call does the work and returns the exit status.

    Its attribute ``after_interrupt``, if it has one, says what Ctrl-C has left behind, as a continuation of the word
    "interrupted"."""

    def __call__(self) -> int: ...


class UsageError(ConfigError):
    """The command line names an option, a value or a command that does not exist."""


SECTIONS = {
    "Run a policy": {
        "check": ("check:Check", "try a policy on one observation before a run"),
        "run": ("run:Run", "run trials of a policy, score them and write the report; --demo runs an example"),
        "demonstrate": ("demonstrate:Demonstrate", "run demonstrations on persons to train on, for `export lerobot`"),
        "serve": ("serve:Serve", "serve a policy to runs on another host"),
        "sweep": ("sweep:Sweep", "run several policies under many conditions, and write one table of all"),
        "merge": ("sweep:Merge", "make one run of parts that ran on several machines"),
    },
    "Read results": {
        "report": ("report:Report", "show the scores of a run, and write its report; --rescore computes them again"),
        "compare": ("compare:Compare", "compare runs trial by trial, and set blind baselines beside them"),
        "view": ("view:View", "look at a recorded trial: in a viewer, as a --video, at its --start, or its --notes"),
        "submit": ("submit:Submit", "check a run of the whole exam, and write its entry of the board"),
        "export lerobot": ("export:Lerobot", "write what a policy saw and did as a dataset for training"),
        "export paper": ("export:Paper", "write the paper's tables and figures from your runs"),
    },
    "Check the benchmark": {
        "verify physics": ("verify:Physics", "check that the simulated person is physically valid"),
        "verify leaks": ("leaks:Leaks", "check that no policy receives what it must not know"),
        "verify metrics": ("verify:Metrics", "check that scores follow the quantities that they measure"),
        "calibrate": ("calibrate:Calibrate", "fit the tissue to measured indentations"),
    },
    "Read and lock protocols": {
        "protocol list": ("protocol:ListProtocols", "list the shipped protocols"),
        "protocol show": ("protocol:Show", "print a protocol with its hash, its lock and its tissue"),
        "protocol verify": ("protocol:Verify", "check that a protocol equals its lock"),
        "protocol lock": ("protocol:Lock", "write the lock of your own protocol"),
        "protocol feasible": ("protocol:Feasible", "check that the robot can serve every person that it draws"),
        "protocol salt": ("protocol:Salt", "make, reveal or verify the secret of a salted run"),
    },
    "Look around": {
        "list": ("names:List", "list tasks, policies, bodies, metrics and every other kind of name"),
        "doctor": ("check:Doctor", "check that this machine can run trials"),
    },
}
"""Heading of the help -> command -> module of this package with the class in it, and what the command does."""
COMMANDS = {name: target for section in SECTIONS.values() for name, (target, _) in section.items()}
RENAMED = {
    "demo": "run --demo",
    "score": "report --rescore",
    "video": "view --video",
    "look": "view --start",
    "notes": "view --notes",
    "paper": "export paper",
    "export lerobot-v2.1": "export lerobot --form v2.1",
    "validate": "verify physics",
    "audit": "verify leaks",
    "probe": "verify metrics",
    "salt": "protocol salt",
}
"""Former name of a command -> how it is called now."""
SYNONYMS = {
    "run": {"--task": "--tasks", "--seed": "--seeds"},
    "compare": {"--null": "--baseline"},
    "report": {"--null": "--baseline"},
}
"""Command -> option that it understands -> the option that its help shows."""
CONFIG = (tyro.conf.DisallowNone, tyro.conf.HelptextFromCommentsOff, tyro.conf.OmitArgPrefixes)
"""Settings of the parser. The help leaves out the default None, which no one types. ``described`` gives the help texts,
so that tyro need not look for comments in the sources."""


def parse(arguments: Sequence[str]) -> Command:
    """Return the command with its options, ready to call; or print the help and exit."""
    if arguments and arguments[0] == "help":
        arguments = [*arguments[1:], "--help"]
    if not arguments or arguments[0] in ("-h", "--help"):
        print(overview())
        raise SystemExit(0)
    name, options = command_of(arguments)
    known = SYNONYMS.get(name, {})
    split = [option.partition("=") for option in options]
    options = [known.get(option, option) + equals + value for option, equals, value in split]
    command = command_class(name)
    _check_options(name, command, options)
    errors = io.StringIO()
    try:
        with redirect_stderr(errors):
            return tyro.cli(command, prog=f"carecontact {name}", args=options, config=CONFIG)
    except SystemExit as end:
        if end.code != 2:
            raise
        lacking = [option for option in ("--policy", "--out") if name == "run" and option not in options]
        raise UsageError(in_one_line(errors.getvalue(), lacking)) from None


def command_of(arguments: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Split a command line into the command, of one word or two, and its options; or print the commands and exit."""
    for words in (2, 1):
        name = " ".join(arguments[:words])
        if name in COMMANDS:
            return name, arguments[words:]
        if name in RENAMED:
            raise UsageError(f"`carecontact {name}` is now `carecontact {RENAMED[name]}`")
    first = arguments[0]
    seconds = [name.partition(" ")[2] for name in COMMANDS if name.startswith(f"{first} ")]
    if seconds and (len(arguments) == 1 or arguments[1] in ("-h", "--help")):
        print(overview(first))
        raise SystemExit(0)
    firsts = list(dict.fromkeys(name.partition(" ")[0] for name in COMMANDS))
    place, given, valid = (f" {first}", arguments[1], seconds) if seconds else ("", first, firsts)
    raise UsageError(
        f"carecontact{place} has no command {given!r}{did_you_mean(given, valid)}; valid: {', '.join(valid)}"
    )


def overview(first: str = "") -> str:
    """Return the help that lists the commands: all of them, or those that begin with one word."""
    lines = [f"usage: carecontact {first or 'COMMAND'} ...", ""]
    if not first:
        lines += ["Measure whether a robot policy touches people well.", ""]
    for heading, section in SECTIONS.items():
        rows = [
            f"  {name:18}{text}" for name, (_, text) in section.items() if f"{name} ".startswith(f"{first} ".lstrip())
        ]
        if rows:
            lines += [heading, *rows, ""]
    lines += [
        "`carecontact COMMAND --help` lists the options of a command; `carecontact --version` prints the version."
    ]
    return "\n".join(lines)


def command_class(name: str) -> type[Any]:
    module, _, made = COMMANDS[name].partition(":")
    return described(getattr(import_module(f"carecontact.cli.{module}"), made))


# What ``--help`` says of an option: its docstring as one paragraph, and its default only where that says something.


@cache
def described(command: type[Any]) -> type[Any]:
    """Return the command, or a group of options, with help texts that tyro prints unchanged, and a box for the options
    of each group. A class is changed only once."""
    for owner in reversed(command.__mro__):
        if not is_dataclass(owner):
            continue
        docs, own = _docstrings(owner), inspect.get_annotations(owner)
        for name, hint, default in _options(owner):
            if name not in own:
                continue
            if is_dataclass(_bare(hint)):
                heading = tyro.conf.arg(name=described(_bare(hint)).heading)
                owner.__annotations__[name] = Annotated[hint, heading]  # pyright: ignore
            elif name in docs:
                help_text = {"help": " ".join(docs[name].split())}
                if default is MISSING:
                    help_text["help_behavior_hint"] = "(required)"
                elif default is None or default is False or default == ():
                    help_text["help_behavior_hint"] = ""
                owner.__annotations__[name] = Annotated[hint, tyro.conf.arg(**help_text)]  # pyright: ignore
    return command


def option_names(command: type[Any]) -> list[str]:
    """Return every option of a command as it is typed, including those of its groups, without positional arguments."""
    names: list[str] = []
    for name, hint, _ in _options(command):
        if is_dataclass(_bare(hint)):
            names += option_names(_bare(hint))
        elif tyro.conf.Positional not in get_args(hint)[1:]:
            names.append(_as_typed(name, hint))
    return names


def given_options(command: Any) -> list[str]:
    """Return the options of a command or group, as they are typed, whose values are not the defaults."""
    names: list[str] = []
    for name, hint, default in _options(type(command)):
        value = getattr(command, name)
        if is_dataclass(value):
            names += given_options(value)
        elif value != default:
            names.append(_as_typed(name, hint))
    return names


def _as_typed(name: str, hint: Any) -> str:
    extras = get_args(hint)[1:]
    if tyro.conf.Positional in extras:
        return name
    named = [extra.name for extra in extras if getattr(extra, "name", None)]
    return f"--{(named or [name])[0].replace('_', '-')}"


def _options(owner: type[Any]) -> Iterator[tuple[str, Any, object]]:
    hints = get_type_hints(owner, include_extras=True)
    for field in fields(owner):
        default = field.default if field.default_factory is MISSING else field.default_factory()
        yield field.name, hints[field.name], default


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


@cache
def _parsed(module: ModuleType) -> ast.Module:
    return ast.parse(inspect.getsource(module))


def _docstrings(owner: type[Any]) -> dict[str, str]:
    """Return each field -> the docstring under it. The class must be at the top level of its module."""
    body = _parsed(sys.modules[owner.__module__]).body
    made = next(node for node in body if isinstance(node, ast.ClassDef) and node.name == owner.__name__)
    found: dict[str, str] = {}
    for pair in zip(made.body, made.body[1:], strict=False):
        match pair:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = text
    return found


# One line about a wrong command line.

NOT_OF_TYPE = re.compile(r"no type matching (\S+) could be instantiated from \[(.*?)\]")
NO_NUMBER = re.compile(r"(?:invalid literal for (int)\(\) with base 10|could not convert string to (float)): ('.*?')")
NO_CHOICE = re.compile(r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of \((.*?)\)")
RULE = re.compile(r"─{8,}|-{8,}")
"""The parser's words, as tyro writes them, and its rules with and without UTF-8."""
LISTED = re.compile(r"T\d+|\d+")
"""A word that looks like a task or a seed."""
MISSING_OPTION, UNRECOGNIZED = "Missing from carecontact ", "Unrecognized options: "


def _check_options(name: str, command: type[Any], arguments: Sequence[str]) -> None:
    """Raises UsageError for the first option that a command does not have."""
    valid = option_names(command)
    for argument in arguments:
        option = argument.partition("=")[0].replace("_", "-")
        if not option.startswith("--") or option in ("--", "--help", *valid):
            continue
        bare = option.removeprefix("--")
        positional = [field for field, hint, _ in _options(command) if tyro.conf.Positional in get_args(hint)[1:]]
        meant = did_you_mean(bare, [known.removeprefix("--") for known in ("--help", *valid)])
        meant = f"; give the {bare} without {option}" if bare in positional else meant.replace("mean '", "mean '--")
        raise UsageError(f"{name} has no option {option}{meant}; `carecontact {name} --help` shows all options")


def in_one_line(box: str, lacking: Sequence[str]) -> str:
    """Return what is wrong, from tyro's framed page. ``lacking``: options to which a stray word may belong."""
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
    text = _stray(re.split(",? ", stray.removeprefix(UNRECOGNIZED)), lacking)
    return "; ".join([text, *([first] if first.startswith(MISSING_OPTION) else []), *help_is])


def _stray(words: Sequence[str], lacking: Sequence[str]) -> str:
    meant = " ".join(f"{option} {word}" for option, word in zip(lacking, words, strict=False))
    if all(LISTED.fullmatch(word) for word in words):
        meant = "a list with commas, such as --tasks T1,T2 or --seeds 0,1"
    return f"no option takes {' '.join(words)}" + (f" (did you mean {meant}?)" if meant else "")


def _no_choice(found: re.Match[str]) -> str:
    given, argument, listed = found.groups()
    valid = [choice for choice in re.findall(r"'(.*?)'", listed) if choice != "None"]
    place = f"{argument}: " if argument.startswith("-") else ""
    return f"{place}no choice named {given!r}{did_you_mean(given, valid)}; valid: {', '.join(valid)}"
