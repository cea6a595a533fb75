"""Commands and options as users type them: synonyms, and what a misspelt one may have meant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from carecontact.cli.option_texts import option_names, positional_names
from carecontact.errors import did_you_mean

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
