"""``carecontact calibrate``: fits tissue to measured trials and writes it with a certificate."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import FLAT, ChangedProtocolGroup
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.calibration.certificate import Content, Value

PERCENT = {
    "nrmse": "NRMSE",
    "peak_error": "peak force",
    "tangent_error": "tangent stiffness",
    "loop_error": "work lost in the loop",
}


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Fit the tissue of one region to measured indentation trials and write a certificate; see docs/calibration.md.
    The fitted tissue keeps the protocol's mesh, mass and thickness."""

    trials: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIALS.csv")]
    """Measured indentation trials; docs/calibration.md lists the columns."""
    region: str | None = None
    """Soft region of the protocol, such as forearm, upper_arm or abdomen. The fit uses the rows whose site begins with
    this name. Required without --verify."""
    body: str = "man-adult"
    """Body that the simulated indenter presses; see `carecontact list bodies`."""
    rules: Annotated[ChangedProtocolGroup, FLAT] = field(default_factory=ChangedProtocolGroup)
    out: Path = Path("runs/calibration")
    """Folder for certificate.json, tissue.toml and calibration.png."""
    verify: Path | None = None
    """Do not fit: simulate this certificate.json again on the same TRIALS.csv and compare. Exit status 1 if a value
    lies outside the tolerance in the certificate. --region, --body, --protocol, --set and --out have no effect then."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Return 1 if a certificate does not verify."""
        if self.verify is not None:
            return _verify(self.trials, self.verify)
        from carecontact.calibration.calibrate import calibrate

        rules = self.rules.load()
        if self.region not in rules.soft_regions:
            wrong = "is missing" if self.region is None else f"{self.region!r} is not a soft region of {rules.id}"
            raise ConfigError(f"--region {wrong}; valid: {', '.join(rules.soft_regions)}")
        began = time.monotonic()
        made = calibrate(
            self.trials, region=self.region, body=self.body, rules=rules, out=self.out,
            on_progress=lambda line: print(f"{time.monotonic() - began:6.0f} s  {line}", flush=True),
        )  # fmt: skip
        _show(made.certificate.content)
        for path in made.written:
            print(path)
        return 0


def _verify(trials: Path, path: Path) -> int:
    from rich.console import Console
    from rich.table import Table

    from carecontact.calibration.certificate import read_certificate
    from carecontact.calibration.verify import verify

    checks = verify(trials, read_certificate(path))
    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("", "certified", "here", ""):
        table.add_column(header)
    for check in checks:
        verdict = ("ok" if check.fine else "FAIL") if check.decides else ("same" if check.fine else "differs")
        table.add_row(check.name, check.certified, check.here, verdict)
    Console(highlight=False, width=None if Console().is_terminal else 120).print(table)
    failed = [check for check in checks if check.decides and not check.fine]
    print(f"the certificate was {'not ' if failed else ''}reproduced on this machine")
    return 1 if failed else 0


def _show(content: Content) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, width=None if Console().is_terminal else 120)

    def table(title: str, *headers: str) -> Table:
        made = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
        for number, header in enumerate(headers):
            made.add_column(header, justify="left" if number == 0 else "right")
        return made

    laws = table("identified response", "law", "formula", "residual", "left out", "AICc - best")
    for one in content.identified:
        left = "-" if one.left_out_rms is None else f"{one.left_out_rms:.2%}"
        above = f"{one.aicc - content.identified[0].aicc:.0f}"
        laws.add_row(one.name, one.formula, f"{one.rms:.2%}", left, above)
    fitted = table("tissue", "parameter", "value", "95 % interval")
    for name, value in content.law.items():
        fitted.add_row(name, *_numbers(value, ".4g"))
    for name, value in content.stiffness.items():
        kind = name.partition("_")[0]
        fitted.add_row(f"{kind} stiffness, simulated [N/mm]", *_numbers(value, ".3f"))
        fitted.add_row(f"{kind} stiffness, measured [N/mm]", f"{content.measured_stiffness[name]:.3f}", "")
    errors = table("simulation against trials", "", "fit", "95 % interval", "held out", "95 % interval")
    for name, label in PERCENT.items():
        held = _numbers(content.held_out[name], "+.1%") if content.held_out else ("-", "-")
        errors.add_row(label, *_numbers(content.agreement[name], "+.1%"), *held)
    r2 = _numbers(content.held_out["r2"], ".3f") if content.held_out else ("-", "-")
    errors.add_row("R2", *_numbers(content.agreement["r2"], ".3f"), *r2)
    for one in (laws, fitted, errors):
        console.print(one)
        console.print()
    for note in content.notes:
        console.print(f"note: {note}", markup=False)


def _numbers(value: Value, style: str) -> tuple[str, str]:
    middle = "not identified" if value.value is None else format(value.value, style)
    if value.ci95 is None:
        return middle, "-"
    low, high = value.ci95
    return middle, f"{low:{style}} to {high:{style}}"
