"""The command line, as typed dataclasses; each calls into the module that does the work."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Protocol

import tyro

from carecontact.errors import ConfigError

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]


class Command(Protocol):
    after_interrupt: ClassVar[str]
    """What Ctrl-C has left, to follow the word "interrupted"."""

    def __call__(self) -> int: ...


class UsageError(ConfigError):
    """An option, value or command that there is not."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Run trials of one policy, score them and write the report. The same command again does only what is missing."""

    policy: str
    """Name of a registered policy (see `carecontact list policies`) or module:Class, importable from here."""
    out: Path
    """Folder for recordings, results.json and report.html."""
    tasks: str = "all"
    """T1,T2 or T1-T7 or all."""
    seeds: str = "all"
    """3 or 0-19 or 0,4,7 or all."""
    protocol: str = "bathing-v1-draft"
    """Id of a shipped protocol, or a .toml file."""
    jobs: int | None = None
    """Trials at once; default: one per core."""
    retry_failed: Switch = False
    """Run trials again that ended as process_failure or harness_error."""

    after_interrupt: ClassVar[str] = "; finished trials are kept, the same command goes on from here"

    def __call__(self) -> int:
        from carecontact.cli.run import run

        return run(
            policy=self.policy,
            out=self.out,
            tasks=self.tasks,
            seeds=self.seeds,
            protocol=self.protocol,
            jobs=self.jobs,
            retry_failed=self.retry_failed,
        )


@dataclass(frozen=True, kw_only=True)
class Demo:
    """The seven tasks once with the state machine, into a fresh folder; fails unless it really touched, pushed and
    scrubbed."""

    out: Path = Path("runs/demo")
    """Folder; a demo that is already there is replaced, anything else is left alone."""
    jobs: int | None = None
    """Trials at once; default: one per core."""

    after_interrupt: ClassVar[str] = "; finished trials are kept until the next demo there, which starts anew"

    def __call__(self) -> int:
        from carecontact.cli.demo import demo

        return demo(out=self.out, jobs=self.jobs)


@dataclass(frozen=True, kw_only=True)
class Score:
    """Compute the scores of a run again from its recordings; no simulator needed."""

    folder: Folder
    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.score import score

        return score(self.folder)


@dataclass(frozen=True, kw_only=True)
class Report:
    """Write report.html of a run again."""

    folder: Folder
    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.score import report

        return report(self.folder)


@dataclass(frozen=True, kw_only=True)
class List:
    """What can be named on the command line."""

    what: Annotated[Literal["tasks", "policies", "protocols", "bodies", "metrics", "all"], tyro.conf.Positional] = "all"
    protocol: str = "bathing-v1-draft"
    """Whose tasks."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.names import show

        return show(self.what, protocol=self.protocol)


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check that this machine can run trials; for what is missing, say the line that installs it."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.doctor import doctor

        return doctor()


COMMANDS = {"run": Run, "demo": Demo, "score": Score, "report": Report, "list": List, "doctor": Doctor}


def parse(arguments: Sequence[str]) -> Command:
    """The command that was asked for, ready to call. Exits by itself on --help; raises UsageError for wrong options."""
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            return tyro.extras.subcommand_cli_from_dict(
                COMMANDS,
                prog="carecontact",
                description="Does a robot policy touch people well?",
                args=list(arguments) or ["--help"],
            )
    except SystemExit as end:
        if end.code != 2:
            raise
        raise UsageError(_in_one_line(said.getvalue())) from None


def _in_one_line(box: str) -> str:
    """From tyro's framed page what is wrong and where help is; the help texts themselves, which are indented, go."""
    rows = [line.strip("│\n ").rstrip() for line in box.splitlines() if not line.startswith(" " * 8, 2)]
    sections = [" ".join(section.split()) for section in "\n".join(rows[1:-1]).split("─" * 8)]
    sections = [section.strip("─ ") for section in sections if section.strip("─ ")]
    if not sections:
        return " ".join(box.split())
    more = [section for section in sections[1:] if section.startswith(("Unrecognized", "For full helptext"))]
    return "; ".join([sections[0].partition(" Got errors:")[0].rstrip("."), *more])
