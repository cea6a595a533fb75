"""``carecontact verify physics`` and ``verify metrics``: whether the simulated person is physically valid, and whether
scores follow what they measure."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from carecontact.cli.console import console, plain_table, print_answer
from carecontact.cli.groups import (
    ChangedProtocolGroup,
    JsonGroup,
    PhysicsGroup,
    RulesGroup,
    Switch,
    Verbose,
    check_body,
    check_folder,
)
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table
    from rich.text import Text

    from carecontact.lab.fem.compare import Comparison
    from carecontact.lab.validation.result import CheckResult, Measure
    from carecontact.lab.validation.run import Validation
    from carecontact.protocol.protocol import Protocol


@dataclass(frozen=True, kw_only=True)
class Physics:
    """Check that the simulated person is physically valid: thirteen checks, each with limits that it must meet."""

    body: tuple[str, ...] = ()
    """Bodies to check; see `carecontact list bodies`; default: the protocol's."""
    physics: PhysicsGroup = field(default_factory=PhysicsGroup)
    quick: Switch = False
    """Run the short form of every check. The full form takes many minutes per body."""
    checks: str = "all"
    """Names of checks separated by commas, such as force-balance,energy, or all."""
    rules: ChangedProtocolGroup = field(default_factory=ChangedProtocolGroup)
    fem: Switch = False
    """Run no check. Press the tissue beside finite elements of layers with skin, and print both; needs scikit-fem."""
    out: Path = Path("runs/validation")
    """Folder for validation.json and the figures."""
    verbose: Verbose = False
    """Print every measured quantity, not only those that missed their limit."""

    output: JsonGroup = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = "; the checks that were finished are in validation.json"

    def __call__(self) -> int:
        from carecontact.human.library import load_body
        from carecontact.lab.validation.run import CHECKS
        from carecontact.plotting import import_matplotlib
        from carecontact.protocol.load import load_protocol

        import_matplotlib()
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
            self._answer(found, passed=passed)
        return 0 if passed else 1

    def _answer(self, found: Mapping[str, Validation], *, passed: bool) -> None:
        from carecontact.cli.answers import BodyAnswer, ValidateAnswer

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
        from carecontact.lab.validation.run import CHECKS, validate, write

        terminal = console()
        title = f"{body}, {rules.title}, tissue {rules.person.tissue_set}{', quick' if self.quick else ''}"
        terminal.print(title, style="bold")

        def keep(so_far: Validation) -> None:
            terminal.print("  ", *_line(so_far.results[-1]), sep="")
            write(so_far, folder)

        validation = validate(rules, body=body, quick=self.quick, checks=names, on_check=keep)
        rows = [(r, m) for r in validation.results for m in (r.measures if self.verbose else r.missed)]
        if rows:
            terminal.print(_checks_table(rows))
        passed = sum(result.passed for result in validation.results)
        verdict = "passed" if passed == len(names) else "FAILED"
        left_out = f", --checks left out {len(CHECKS) - len(names)}" if len(names) < len(CHECKS) else ""
        print(f"{verdict}: {passed} of {len(names)} checks passed{left_out}; {folder / 'validation.json'}")
        return validation


def _line(result: CheckResult) -> tuple[Text, str]:
    limits = [m for m in result.measures if m.limit is not None and m.decides]
    text = result.error or f"{sum(bool(m.met) for m in limits)} of {len(limits)} limits met"
    if not result.error and (shown := [m for m in result.measures if m.limit is not None and not m.decides]):
        text += f"; {sum(not m.met for m in shown)} of {len(shown)} that do not decide missed"
    return _mark(result.passed, "pass", "FAIL"), f"  {result.title:<42} {text}"


def _checks_table(rows: list[tuple[CheckResult, Measure]]) -> Table:
    table = plain_table("check", "measured", "value", "limit", "", left=("measured", ""))
    for result, measure in rows:
        limit = "" if measure.limit is None else f"{measure.side} {measure.limit:g} {measure.unit}"
        verdict = "" if measure.met is None else _mark(measure.met, "met", "missed")
        if measure.met is not None and not measure.decides:
            verdict = f"{'met' if measure.met else 'not met'} (does not decide)"
        table.add_row(result.check, measure.name, f"{measure.value:.3g} {measure.unit}", limit, verdict)
    return table


def show_beside(rules: Protocol, body: str, folder: Path) -> None:
    from carecontact.lab.fem.compare import as_json, compare, draw
    from carecontact.lab.validation.subject import Subject
    from carecontact.plotting import draw_figure
    from carecontact.protocol.overrides import overridden

    terminal = console()
    title = f"{body}, {rules.title}, tissue {rules.person.tissue_set}, beside finite elements"
    terminal.print(title, style="bold")

    def show(done: Comparison) -> None:
        terminal.print(_fem_table(done))
        for name, value in done.extras.items():
            terminal.print(f"  {name}: {value:.2f}")

    found = compare(Subject(overridden(rules, {"person.body": body})), on_region=show)
    folder.mkdir(parents=True, exist_ok=True)
    record, picture = folder / "fem.json", folder / "fem.png"
    record.write_text(json.dumps(as_json(found), indent=2) + "\n")
    draw_figure(partial(draw, found), picture)
    print(f"{record}, {picture}")


def _fem_table(done: Comparison) -> Table:
    from carecontact.lab.fem.compare import CLOSE_PERCENT

    ground = done.case.ground
    radius = ground.limb_radius_m
    shape = "flat" if radius is None else f"round, radius {1000 * radius:.0f} mm"
    table = plain_table("measured", "skins", "middle skin", "no skin", "simulator", f"within {CLOSE_PERCENT:g} %")
    table.title = f"{done.case.region}: {1000 * ground.thickness_m:.0f} mm of tissue over bone, {shape}"
    for row in done.rows():
        standard = row.standard
        skins = f"{min(standard.skins):.2f} to {max(standard.skins):.2f}"
        values = [f"{value:.2f}" for value in (standard.skins[0], standard.plain, row.simulated)]
        name = f"{standard.name} ({standard.unit})" if standard.unit else standard.name
        table.add_row(name, skins, *values, _mark(row.agrees, "yes", f"{row.outside_percent:.0f} % outside"))
    moduli = ", ".join(f"{answer.modulus_pa / 1000:.1f}" for answer in done.skins)
    table.caption = f"tissue under the skins: {moduli} kPa; without skin {done.plain.modulus_pa / 1000:.1f} kPa"
    return table


def _mark(good: bool, yes: str, no: str) -> Text:
    from rich.text import Text

    return Text(yes, "green") if good else Text(no, "red")


SCHEMA = "carecontact-probe-1"


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Check that C1, C2, C4 and C5 follow the quantities that they measure: for each score, simulate scripted
    trials in which one quantity changes step by step (a sweep, for example of the commanded depth), and plot them."""

    metrics: str = "all"
    """Ids separated by commas, such as C1,C5 (short for C1@1,C5@1), or all (C1@1, C2@1, C4@1, C5@1)."""
    rules: RulesGroup = field(default_factory=RulesGroup)
    out: Path = Path("runs/probe")
    """Folder for probe.json and probe.png."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.lab.validation.probes import PROBES, run
        from carecontact.lab.validation.subject import Subject
        from carecontact.plotting import import_matplotlib

        import_matplotlib()
        short = {name.partition("@")[0].casefold(): name for name in PROBES}
        given = [part.strip() for part in self.metrics.split(",")]
        names = tuple(PROBES) if self.metrics == "all" else tuple(short.get(name.casefold(), name) for name in given)
        if not set(names) <= set(PROBES) or len(set(names)) != len(names):
            raise ConfigError(
                f"--metrics {self.metrics!r}: expected ids separated by commas, each once; valid: {', '.join(PROBES)}"
            )
        check_folder(self.out)
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
        "schema": SCHEMA,
        "passed": passed,
        "protocol": {"id": rules.id, "sha256": rules.sha256},
        "body": rules.person.body,
        "probes": [result.as_json() for result in results],
    }
    (out / "probe.json").write_text(json.dumps(content, indent=2) + "\n")
    draw_figure(partial(draw, results), out / "probe.png")
