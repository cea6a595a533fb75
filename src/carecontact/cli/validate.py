"""``carecontact validate`` and ``probe``: whether the simulated person is physically valid, and whether scores follow
what they measure."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, ChangedProtocolGroup, JsonGroup, PhysicsGroup, RulesGroup, Switch, check_body
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table

    from carecontact.lab.fem.compare import Comparison
    from carecontact.lab.validation.result import CheckResult, Measure
    from carecontact.lab.validation.run import Validation
    from carecontact.protocol.protocol import Protocol


# The table of ``carecontact validate --fem``.


def show_beside(rules: Protocol, body: str, folder: Path) -> None:
    """Print the comparison region by region and write ``fem.json`` and ``fem.png``.

    Raises DependencyError where scikit-fem is missing.
    """
    from rich.console import Console

    from carecontact.lab.fem.compare import as_json, compare, draw
    from carecontact.lab.validation.subject import Subject
    from carecontact.plotting import draw_figure
    from carecontact.protocol.overrides import overridden

    console = Console(highlight=False, width=None if Console().is_terminal else 140)
    console.print(f"{body}, {rules.title}, tissue {rules.person.tissue_set}, beside finite elements", style="bold")

    def show(done: Comparison) -> None:
        console.print(_table(done))
        for name, value in done.extras.items():
            console.print(f"  {name}: {value:.2f}")

    found = compare(Subject(overridden(rules, {"person.body": body})), on_region=show)
    folder.mkdir(parents=True, exist_ok=True)
    record, picture = folder / "fem.json", folder / "fem.png"
    record.write_text(json.dumps(as_json(found), indent=2) + "\n")
    draw_figure(partial(draw, found), picture)
    print(f"{record}, {picture}")


def _table(done: Comparison) -> Table:
    from rich.table import Table

    from carecontact.lab.fem.compare import CLOSE_PERCENT

    ground = done.case.ground
    radius = ground.limb_radius_m
    shape = "flat" if radius is None else f"round, radius {1000 * radius:.0f} mm"
    table = Table(box=None, pad_edge=False, header_style="bold", title_justify="left")
    table.title = f"{done.case.region}: {1000 * ground.thickness_m:.0f} mm of tissue over bone, {shape}"
    for header in ("measured", "skins", "middle skin", "no skin", "simulator", f"within {CLOSE_PERCENT:g} %"):
        table.add_column(header, justify="left" if header == "measured" else "right")
    for row in done.rows():
        standard = row.standard
        verdict = "[green]yes[/green]" if row.agrees else f"[red]{row.outside_percent:.0f} % outside[/red]"
        table.add_row(
            f"{standard.name}{f' ({standard.unit})' if standard.unit else ''}",
            f"{min(standard.skins):.2f} to {max(standard.skins):.2f}", f"{standard.skins[0]:.2f}",
            f"{standard.plain:.2f}", f"{row.simulated:.2f}", verdict,
        )  # fmt: skip
    moduli = ", ".join(f"{answer.modulus_pa / 1000:.1f}" for answer in done.skins)
    table.caption = f"tissue under the skins: {moduli} kPa; without skin {done.plain.modulus_pa / 1000:.1f} kPa"
    return table


# ``carecontact validate``: is the simulated person physically valid?


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Check that the simulated person is physically valid: thirteen checks, each with limits that it must meet."""

    body: tuple[str, ...] = ()
    """Bodies to check; see `carecontact list bodies`; default: the protocol's."""
    physics: Annotated[PhysicsGroup, FLAT] = field(default_factory=PhysicsGroup)
    quick: Switch = False
    """Run the short form of every check. The full form takes many minutes per body."""
    checks: str = "all"
    """Names of checks separated by commas, such as force-balance,energy, or all."""
    rules: Annotated[ChangedProtocolGroup, FLAT] = field(default_factory=ChangedProtocolGroup)
    fem: Switch = False
    """Run no check. Press the tissue beside finite elements of layers with skin, and print both; needs scikit-fem."""
    out: Path = Path("runs/validation")
    """Folder for validation.json and the figures."""
    verbose: Switch = False
    """Print every measured quantity, not only those that missed their limit."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = "; the checks that were finished are in validation.json"

    def __call__(self) -> int:
        """Return 1 if any check fails on any body."""
        from carecontact.human.library import load_body
        from carecontact.lab.validation.run import CHECKS
        from carecontact.protocol.load import load_protocol

        loaded = load_protocol(self.rules.protocol, level=self.rules.level)
        rules = self.rules.changed(loaded, **self.physics.changes(loaded))
        names = tuple(CHECKS) if self.checks == "all" else tuple(part.strip() for part in self.checks.split(","))
        if not all(names) or len(set(names)) != len(names):
            raise ConfigError(
                f"--checks {self.checks!r}: expected names separated by commas, each once; valid: {', '.join(CHECKS)}"
            )
        wanted = self.body or (rules.person.body,)
        for body in self.body:
            check_body(body)
        if not self.body:
            load_body(rules.person.body)
        if self.fem:
            return self._beside_finite_elements(rules, wanted)
        found = {body: self._validate(rules, body, names, self._folder(body, wanted)) for body in wanted}
        passed = all(validation.passed for validation in found.values())
        if self.output.json:
            self._say(found, passed=passed)
        return 0 if passed else 1

    def _say(self, found: Mapping[str, Validation], *, passed: bool) -> None:
        from carecontact.cli.answers import BodyAnswer, ValidateAnswer
        from carecontact.cli.console import print_answer

        bodies = [
            {
                "body": body,
                "passed": validation.passed,
                "record": str(self._folder(body, tuple(found)) / "validation.json"),
                "checks": [result.as_json() for result in validation.results],
            }
            for body, validation in found.items()
        ]
        print_answer(ValidateAnswer(passed=passed, bodies=[BodyAnswer.model_validate(body) for body in bodies]))

    def _folder(self, body: str, wanted: tuple[str, ...]) -> Path:
        # A body may be a file: its name as a folder keeps letters and digits only.
        return self.out / re.sub(r"[^A-Za-z0-9_-]+", "_", body) if len(wanted) > 1 else self.out

    def _beside_finite_elements(self, rules: Protocol, wanted: tuple[str, ...]) -> int:
        if self.quick or self.checks != "all" or self.output.json:
            raise ConfigError("--fem runs no check; leave out --quick, --checks and --json")

        for body in wanted:
            show_beside(rules, body, self._folder(body, wanted))
        return 0

    def _validate(self, rules: Protocol, body: str, names: tuple[str, ...], folder: Path) -> Validation:
        from rich.console import Console

        from carecontact.lab.validation.run import CHECKS, validate, write

        console = Console(highlight=False, width=None if Console().is_terminal else 140)
        title = f"{rules.title}, tissue {rules.person.tissue_set}"
        console.print(f"{body}, {title}{', quick' if self.quick else ''}", style="bold")

        def keep(so_far: Validation) -> None:
            console.print(_line(so_far.results[-1]))
            write(so_far, folder)

        validation = validate(rules, body=body, quick=self.quick, checks=names, on_check=keep)
        missed = [(result, measure) for result in validation.results for measure in result.missed]
        if self.verbose or missed:
            rows = [(r, m) for r in validation.results for m in r.measures] if self.verbose else missed
            console.print(_checks_table(rows))
        failed = [result for result in validation.results if not result.passed]
        print(f"{_verdict(len(failed), ran=len(names), of=len(CHECKS))}; {folder / 'validation.json'}")
        return validation


def _verdict(failed: int, *, ran: int, of: int) -> str:
    """Return how many checks failed, of those that ran, and of how many there are where not all ran."""
    checks = f"{of} checks" if ran == of else f"{ran} check{'s' * (ran > 1)} that ran (of {of})"
    return f"FAILED: {failed} of the {checks}" if failed else f"passed: the {checks}"


def _line(result: CheckResult) -> str:
    colour = "green" if result.passed else "red"
    limits = [m for m in result.measures if m.limit is not None and m.decides]
    told = result.error or f"{sum(bool(m.met) for m in limits)} of {len(limits)} limits met"
    if not result.error and (shown := [m for m in result.measures if m.limit is not None and not m.decides]):
        told += f"; {sum(not m.met for m in shown)} of {len(shown)} that do not decide missed"
    return f"  [{colour}]{'pass' if result.passed else 'FAIL'}[/{colour}]  {result.title:<42} {told}"


def _checks_table(rows: list[tuple[CheckResult, Measure]]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("check", "measured", "value", "limit", ""):
        table.add_column(header, justify="right" if header in ("value", "limit") else "left")
    for result, measure in rows:
        limit = "" if measure.limit is None else f"{measure.side} {measure.limit:g} {measure.unit}"
        verdict = {None: "", True: "[green]met[/green]", False: "[red]missed[/red]"}[measure.met]
        if measure.met is not None and not measure.decides:
            verdict = f"{'met' if measure.met else 'not met'} (does not decide)"
        table.add_row(result.check, measure.name, f"{measure.value:.3g} {measure.unit}", limit, verdict)
    return table


# ``carecontact probe``: do scores follow the quantities that they measure?

SCHEMA = "carecontact-probe-1"


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Check that C1, C2, C4 and C5 follow the quantities that they measure: for each score, simulate scripted
    trials in which one quantity changes step by step (a sweep, for example of the commanded depth), and plot them."""

    metrics: str = "all"
    """Ids separated by commas, such as C1,C5 (short for C1@1,C5@1), or all (C1@1, C2@1, C4@1, C5@1)."""
    rules: Annotated[RulesGroup, FLAT] = field(default_factory=RulesGroup)
    out: Path = Path("runs/probe")
    """Folder for probe.json and probe.png."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Return 1 if a score does not follow its sweep."""
        from carecontact.lab.validation.probes import PROBES, run
        from carecontact.lab.validation.subject import Subject

        short = {name.partition("@")[0].casefold(): name for name in PROBES}
        given = [part.strip() for part in self.metrics.split(",")]
        names = tuple(PROBES) if self.metrics == "all" else tuple(short.get(name.casefold(), name) for name in given)
        if not set(names) <= set(PROBES) or len(set(names)) != len(names):
            raise ConfigError(
                f"--metrics {self.metrics!r}: expected ids separated by commas, each once; valid: {', '.join(PROBES)}"
            )
        if self.out.exists() and not self.out.is_dir():
            raise ConfigError(f"--out {self.out}: this is a file; name a folder")
        rules = self.rules.load()
        subject = Subject(rules)
        print(f"{rules.title}, {rules.person.body}", flush=True)
        results = []
        for name in names:
            result = run(subject, PROBES[name])
            results.append(result)
            levels, scores = result.curves["scores"]
            print(f"{'pass' if result.passed else 'FAIL'}  {name}  {result.title}")
            for level, score in zip(levels, scores, strict=True):
                print(f"        {PROBES[name].level} {level:<6g} {score:.4g}", flush=True)
        passed = all(result.passed for result in results)
        _write(self.out, rules, results, passed=passed)
        print(f"{'passed' if passed else 'FAILED'}: {self.out / 'probe.json'}, {self.out / 'probe.png'}")
        return 0 if passed else 1


def _write(out: Path, rules: Protocol, results: list[CheckResult], *, passed: bool) -> None:
    from carecontact.lab.validation.probes import draw
    from carecontact.plotting import draw_figure

    out.mkdir(parents=True, exist_ok=True)
    content = {
        "schema": SCHEMA, "passed": passed, "protocol": {"id": rules.id, "sha256": rules.sha256},
        "body": rules.person.body, "probes": [result.as_json() for result in results],
    }  # fmt: skip
    (out / "probe.json").write_text(json.dumps(content, indent=2) + "\n")
    draw_figure(partial(draw, results), out / "probe.png")
