"""``carecontact validate``: is the simulated person physically valid?"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, ChangedProtocolGroup, JsonGroup, PhysicsGroup, Switch, check_body
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table

    from carecontact.contract.protocol import Protocol
    from carecontact.validation.result import CheckResult, Measure
    from carecontact.validation.run import Validation


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
        from carecontact.protocols import load_protocol
        from carecontact.validation.run import CHECKS
        from carecontact.world.human.library import load_body

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
        from carecontact.cli.answers.validate import BodyAnswer, ValidateAnswer
        from carecontact.cli.json_lines import say

        bodies = [
            {
                "body": body,
                "passed": validation.passed,
                "record": str(self._folder(body, tuple(found)) / "validation.json"),
                "checks": [result.as_json() for result in validation.results],
            }
            for body, validation in found.items()
        ]
        say(ValidateAnswer(passed=passed, bodies=[BodyAnswer.model_validate(body) for body in bodies]))

    def _folder(self, body: str, wanted: tuple[str, ...]) -> Path:
        # A body may be a file: its name as a folder keeps letters and digits only.
        return self.out / re.sub(r"[^A-Za-z0-9_-]+", "_", body) if len(wanted) > 1 else self.out

    def _beside_finite_elements(self, rules: Protocol, wanted: tuple[str, ...]) -> int:
        if self.quick or self.checks != "all" or self.output.json:
            raise ConfigError("--fem runs no check; leave out --quick, --checks and --json")
        from carecontact.cli.finite_elements import show_beside

        for body in wanted:
            show_beside(rules, body, self._folder(body, wanted))
        return 0

    def _validate(self, rules: Protocol, body: str, names: tuple[str, ...], folder: Path) -> Validation:
        from rich.console import Console

        from carecontact.validation.run import CHECKS, validate, write

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
            console.print(_table(rows))
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


def _table(rows: list[tuple[CheckResult, Measure]]) -> Table:
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
