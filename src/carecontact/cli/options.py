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
Segmenter = Literal["mediapipe", "grounded-sam"]
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
    """Name of a registered policy (see `carecontact list policies`), module:Class, importable from here, or
    ws://HOST:PORT of a policy that is served (see `carecontact serve`)."""
    out: Path
    """Folder for recordings, results.json and report.html."""
    tasks: str = "all"
    """T1,T2 or T1-T7 or all."""
    seeds: str = "all"
    """3 or 0-19 or 0,4,7 or all."""
    protocol: str = "bathing-v1"
    """Id of a shipped protocol, or a .toml file."""
    body: str | None = None
    """Another person than the protocol's: a name of `carecontact list bodies` or smplx:FILE.npz?sex=F (or M). Every
    output says so, and such trials are never pooled with the protocol's own."""
    tissue: str | None = None
    """Other tissue than the protocol's: a name of `carecontact list tissue` or a .toml file, as calibrate writes it."""
    stiffness: float | None = None
    """Of the arm's translation [N/m], another than the protocol's; every output says so. What a policy sets by itself
    stays as it sets it."""
    language: str | None = None
    """rules-v1, replay:FILE.jsonl or live:MODEL for policies that use language (see docs/language.md); default: the
    policy's own."""
    record: Path | None = None
    """With a live language model: replay file to add its completions to."""
    fast: Switch = False
    """Physics steps of 4 ms instead of the protocol's: fewer steps a second, for development."""
    segmenter: Segmenter | None = None
    """What finds the person for the masks, instead of the protocol's own (mediapipe): see docs/perception.md."""
    weights: Path | None = None
    """Folder with the weights of --segmenter grounded-sam; nothing is ever downloaded."""
    unfrozen: Switch = False
    """Run a frozen protocol although it drifted from its lock (see `carecontact protocol verify`); every output shows
    it."""
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
            body=self.body,
            tissue=self.tissue,
            stiffness=self.stiffness,
            language=self.language,
            record=self.record,
            fast=self.fast,
            segmenter=self.segmenter,
            weights=self.weights,
            unfrozen=self.unfrozen,
            jobs=self.jobs,
            retry_failed=self.retry_failed,
        )


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Serve a policy to `carecontact run --policy ws://HOST:PORT` on another host, until Ctrl-C. Every trial that
    connects gets a process of its own. Anyone who reaches the port may use it: see docs/threat-model.md."""

    policy: Annotated[str, tyro.conf.Positional]
    """Name of a registered policy (see `carecontact list policies`) or module:Class, importable from here."""
    host: str = "127.0.0.1"
    """Address of this host to listen at; 0.0.0.0 for all of them."""
    port: int = 8765
    """0: one that is free."""
    at_once: int | None = None
    """Trials at once, further ones wait; default: one per core."""
    language: str | None = None
    """rules-v1, replay:FILE.jsonl or live:MODEL for policies that use language (see docs/language.md); default: the
    policy's own."""

    after_interrupt: ClassVar[str] = "; its policies have ended"

    def __call__(self) -> int:
        from carecontact.cli.serve import serve

        return serve(self.policy, host=self.host, port=self.port, at_once=self.at_once, language=self.language)


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
    append: Switch = False
    """Only add the metrics that results.json does not have yet; everything in it stays as it is."""
    jobs: int | None = None
    """Processes; default: one per core, fewer for a few recordings."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.score import append, score

        return append(self.folder) if self.append else score(self.folder, jobs=self.jobs)


@dataclass(frozen=True, kw_only=True)
class Report:
    """Write report.html of a run again."""

    folder: Folder
    null: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of null arms on the same protocol, to be set beside this one as false-positive rates. They stay in the
    report when it is written again; naming others replaces them."""
    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.score import report

        return report(self.folder, nulls=self.null)


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare runs of one protocol. Two: trial by trial, what differs and what could not have been seen. More: rates,
    every pair, and whether their ranking survives other gates. See docs/statistics.md."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN_A [RUN_B ...]")]
    """Folders of runs, or their results.json alone; differences are A minus B."""
    null: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of null arms: what they pass, beside each run; with them one run is enough."""
    per_task: Switch = False
    """A table for each task too; they are a family of their own. For two runs."""
    out: Path | None = None
    """Folder for comparison.json (two runs) and overview.json (more, or null arms); default: none is written."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.compare import compare

        return compare(self.runs, nulls=self.null, per_task=self.per_task, out=self.out)


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Prove that the simulated person is physically valid: eight checks and two measurements, with pass lines."""

    body: tuple[str, ...] = ()
    """Bodies to check (see `carecontact list bodies`); default: the protocol's."""
    tissue: str | None = None
    """Other tissue than the protocol's: a name of `carecontact list tissue` or a .toml file, as calibrate writes it."""
    fast: Switch = False
    """Physics steps of 4 ms instead of the protocol's."""
    quick: Switch = False
    """The short form of every check, for continuous integration; the full one takes many minutes a body."""
    checks: str = "all"
    """force-balance,energy or all."""
    protocol: str = "bathing-v1"
    """Id of a shipped protocol, or a .toml file."""
    out: Path = Path("runs/validation")
    """Folder for validation.json and the figures."""
    verbose: Switch = False
    """Print every measured quantity, not only missed lines."""

    after_interrupt: ClassVar[str] = "; the checks that were finished are in validation.json"

    def __call__(self) -> int:
        from carecontact.cli.validate import validate

        return validate(
            bodies=self.body,
            tissue=self.tissue,
            fast=self.fast,
            quick=self.quick,
            checks=self.checks,
            protocol=self.protocol,
            out=self.out,
            verbose=self.verbose,
        )


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Prove that each score follows what it scores: four scripted sweeps in simulation, plotted."""

    metrics: str = "all"
    """C1@1,C5@1 or all (C1@1, C2@1, C4@1, C5@1)."""
    body: str | None = None
    """Another person than the protocol's (see `carecontact list bodies`)."""
    protocol: str = "bathing-v1"
    """Id of a shipped protocol, or a .toml file."""
    out: Path = Path("runs/probe")
    """Folder for probe.json and probe.png."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.cli.probe import probe

        return probe(metrics=self.metrics, body=self.body, protocol=self.protocol, out=self.out)


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Fit a region's tissue to measured indentation trials, with certificate and figure; see docs/calibration.md."""

    trials: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIALS.csv")]
    region: Annotated[
        Literal["forearm", "upper_arm", "abdomen"] | None, tyro.conf.arg(metavar="{forearm,upper_arm,abdomen}")
    ] = None
    """Rows whose site begins with this; needed unless --verify is given."""
    body: str = "man-adult"
    """Whose surface is pressed (see `carecontact list bodies`)."""
    protocol: str = "bathing-v1"
    """Whose mesh, mass and thickness the tissue keeps."""
    out: Path = Path("runs/calibration")
    """Folder for certificate.json, tissue.toml and calibration.png."""
    verify: Path | None = None
    """A certificate.json: simulate it again on the same trials and compare; exit status 1 outside its band."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.cli.calibrate import calibrate

        return calibrate(
            trials=self.trials,
            region=self.region,
            body=self.body,
            protocol=self.protocol,
            out=self.out,
            certificate=self.verify,
        )


@dataclass(frozen=True, kw_only=True)
class Look:
    """Draw everything that a policy sees when a trial begins, on one sheet: every camera, every modality."""

    task: str
    """T1, or another of the protocol."""
    seed: int = 0
    """One of the protocol's."""
    body: str | None = None
    """Another person than the protocol's: a name of `carecontact list bodies` or smplx:FILE.npz?sex=F (or M)."""
    protocol: str = "bathing-v1"
    """Id of a shipped protocol, or a .toml file."""
    segmenter: Segmenter | None = None
    """What finds the person for the masks, instead of the protocol's own (mediapipe): see docs/perception.md."""
    weights: Path | None = None
    """Folder with the weights of --segmenter grounded-sam; nothing is ever downloaded."""
    out: Path | None = None
    """Picture to write, .png, .jpg or .pdf; default: look-TASK-sSEED.png here."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.cli.look import look

        return look(
            task=self.task,
            seed=self.seed,
            protocol=self.protocol,
            body=self.body,
            out=self.out,
            segmenter=self.segmenter,
            weights=self.weights,
        )


@dataclass(frozen=True, kw_only=True)
class Audit:
    """Try to catch the benchmark cheating: does anything that a policy is sent depend on what it must not know?"""

    policy: tuple[str, ...] = ()
    """Policies to audit (see `carecontact list policies`, or module:Class); default: every registered one."""
    quick: Switch = False
    """One region and short trials, for continuous integration; the full form takes minutes."""
    body: str | None = None
    """Another person than the protocol's (see `carecontact list bodies`)."""
    protocol: str = "bathing-v1"
    """Id of a shipped protocol, or a .toml file."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/audit")
    """Folder for audit.json."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.cli.audit import audit

        return audit(policies=self.policy, quick=self.quick, body=self.body, protocol=self.protocol, out=self.out)


@dataclass(frozen=True, kw_only=True)
class Notes:
    """Draw what a policy noted in a trial over what it saw: the state machine's options and choice, VoxPoser's value
    maps and paths."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL.h5")]
    out: Path | None = None
    """Picture to write, .png, .jpg or .pdf; default: notes-TRIAL.png here."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.cli.notes import notes

        return notes(self.recording, out=self.out)


@dataclass(frozen=True, kw_only=True)
class List:
    """What can be named on the command line."""

    what: Annotated[
        Literal["tasks", "policies", "protocols", "bodies", "tissue", "metrics", "all"], tyro.conf.Positional
    ] = "all"
    protocol: str = "bathing-v1"
    """Whose tasks."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.names import show

        return show(self.what, protocol=self.protocol)


@dataclass(frozen=True, kw_only=True)
class Protocols:
    """Protocols and their locks: list them, show one, verify that it is what was frozen, or lock a file of yours."""

    what: Annotated[Literal["list", "show", "verify", "lock"], tyro.conf.Positional]
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE.toml")] = "bathing-v1"
    """Id of a shipped protocol, or a .toml file."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli import names, protocol

        if self.what == "list":
            return names.show("protocols", protocol=self.name)
        return {"show": protocol.show, "verify": protocol.verify, "lock": protocol.lock}[self.what](self.name)


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check that this machine can run trials; for what is missing, say the line that installs it."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.doctor import doctor

        return doctor()


COMMANDS = {
    "run": Run,
    "serve": Serve,
    "demo": Demo,
    "score": Score,
    "report": Report,
    "compare": Compare,
    "validate": Validate,
    "calibrate": Calibrate,
    "look": Look,
    "audit": Audit,
    "notes": Notes,
    "probe": Probe,
    "protocol": Protocols,
    "list": List,
    "doctor": Doctor,
}


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
