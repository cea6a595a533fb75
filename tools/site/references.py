"""Reference pages that are made from the code: every command with its options, and what programs may import."""

from __future__ import annotations

import io
import os
import re
import textwrap
from contextlib import redirect_stdout
from importlib import import_module

import carecontact
from carecontact.cli.parsing import COMMANDS, parse

WIDTH = 80
"""Characters in a line of a command's help: what the site shows beside its two menus without scrolling."""
COLOUR = re.compile(r"\x1b\[[0-9;]*m")

OFFERED = {
    "Results and evaluation": [
        "carecontact.api.run.load",
        "carecontact.api.run.Run",
        "carecontact.api.run.compare",
        "carecontact.api.evaluate.evaluate",
    ],
    "What a policy receives and answers": [
        "carecontact.interface.policy.PolicyCard",
        "carecontact.interface.policy.Policy",
        "carecontact.interface.observation.Observation",
        "carecontact.interface.observation.CameraView",
        "carecontact.interface.action.Action",
        "carecontact.interface.robot.Session",
        "carecontact.interface.robot.Compliance",
    ],
    "Episodes in a loop of your own": [
        "carecontact.episode.episode.Episode",
        "carecontact.episode.episode.Step",
        "carecontact.episode.worlds.Worlds",
        "carecontact.scoring.online.Progress",
        "carecontact.protocol.protocol.TrialSpec",
        "carecontact.protocol.load.load_protocol",
    ],
    "Recordings and scores": [
        "carecontact.recording.schema.Recording",
        "carecontact.recording.schema.Header",
        "carecontact.recording.file.read_recording",
        "carecontact.recording.file.write_recording",
        "carecontact.scoring.score.score_recording",
        "carecontact.scoring.result.TrialScore",
    ],
    "Learning": [
        "carecontact.learn.bathing.Bathing",
        "carecontact.learn.bathing.BathingState",
        "carecontact.learn.bathing.make_vec",
        "carecontact.interface.learned.LearnedActions",
        "carecontact.interface.learned.DatasetRows",
        "carecontact.interface.learned.square",
        "carecontact.interface.learned.cloud",
    ],
    "Errors": ["carecontact.errors"],
}
"""Heading -> what the page documents below it."""


def commands_help() -> str:
    """Every command's help, as the command prints it: the end of the page of commands."""
    parts = ["## Every option"]
    for name in COMMANDS:
        parts += [f"### {name}", f"```text\n{command_help(name)}\n```"]
    return "\n\n".join(parts) + "\n"


def python_page() -> str:
    """Directives for mkdocstrings. Raises AttributeError or ImportError for a name that the code does not have."""
    parts = ["# Python reference", "What programs may import; [Python](../python.md) shows how it is used."]
    for heading, names in OFFERED.items():
        parts.append(f"## {heading}")
        for name in names:
            _check(name)
            parts.append(f"::: {name}\n    options:\n      heading: {_imported_as(name)}")
    return "\n\n".join(parts) + "\n"


def _check(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    if not hasattr(import_module(module), attribute):
        import_module(name)


def _imported_as(name: str) -> str:
    """Return the shortest dotted name under which a program imports something."""
    short = name.rpartition(".")[2]
    return f"carecontact.{short}" if hasattr(carecontact, short) else name


def command_help(name: str) -> str:
    """Return what ``carecontact NAME --help`` prints, in lines of at most ``WIDTH`` characters."""
    os.environ["COLUMNS"] = str(WIDTH)
    printed = io.StringIO()
    try:
        with redirect_stdout(printed):
            parse([*name.split(), "--help"])
    except SystemExit:
        pass
    lines = COLOUR.sub("", printed.getvalue()).strip().splitlines()
    return "\n".join("\n".join(textwrap.wrap(line, WIDTH)) if len(line) > WIDTH else line.rstrip() for line in lines)
