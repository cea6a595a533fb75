"""Makes one line of what the parser prints about a wrong command line."""

from __future__ import annotations

import re
from collections.abc import Sequence

from carecontact.errors import did_you_mean

NOT_OF_TYPE = re.compile(r"no type matching (\S+) could be instantiated from \[(.*?)\]")
NO_NUMBER = re.compile(r"(?:invalid literal for (int)\(\) with base 10|could not convert string to (float)): ('.*?')")
NO_CHOICE = re.compile(r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of \((.*?)\)")
RULE = re.compile(r"─{8,}|-{8,}")
"""The parser's words, as tyro writes them, and its rules with and without UTF-8."""
LISTED = re.compile(r"T\d+|\d+")
"""A word that looks like a task or a seed."""
MISSING, UNRECOGNIZED = "Missing from carecontact ", "Unrecognized options: "


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
    return "; ".join([told, *([first] if first.startswith(MISSING) else []), *help_is])


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
