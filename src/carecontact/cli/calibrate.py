"""``carecontact calibrate``: fits tissue to measured trials and writes it with a certificate and a verdict."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from carecontact.cli.console import console, plain_table
from carecontact.cli.groups import ChangedProtocolGroup, Switch
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table

    from carecontact.lab.calibration.certificate import Content, Value
    from carecontact.lab.calibration.trial import Setup

PERCENT = {
    "nrmse": "NRMSE",
    "peak_error": "peak force",
    "tangent_error": "tangent stiffness",
    "work_error": "total work lost",
}


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Fit the tissue of one or more regions to measured indentation trials, and judge the fit; see
    docs/person.md. The fitted tissue keeps the protocol's mesh, mass and thickness."""

    trials: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="TRIALS.csv...")] = ()
    """Measured indentation trials, in one file or in several, such as one for each press; docs/person.md lists the
    columns."""
    region: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Soft region of the protocol, such as forearm, upper_arm or abdomen. The fit uses the rows whose site begins with
    this name; if the files have no column site, all rows. Repeat the option for more regions; default: every region in
    the column site."""
    indenter: str | None = None
    """Indenter of all presses, if the files do not state it: SHAPE:RADIUS with the radius in mm, such as flat:10.7 or
    hemisphere:10, or cap for the shipped tool."""
    at: str | None = None
    """Place of all presses in the region's frame, if the files do not state it: ALONG,ACROSS or ALONG,ACROSS,TILT in mm
    and degrees; default: 0,0,0, the region's middle."""
    setup: Path | None = None
    """TOML file with values of columns that the files do not have, for all files or for one (see
    docs/person.md)."""
    template: Switch = False
    """Print a file of trials to fill in, and do nothing else."""
    body: str = "man-adult"
    """Body that the simulated indenter presses; see `carecontact list bodies`."""
    rules: ChangedProtocolGroup = field(default_factory=ChangedProtocolGroup)
    out: Path = Path("runs/calibration")
    """Folder for certificate.json, tissue.toml and calibration.png."""
    verify: Path | None = None
    """Do not fit: simulate this certificate.json again on the same TRIALS.csv and compare. Exit status 1 if a value
    lies outside the tolerance in the certificate, or the certificate was rejected. No other option has an effect
    then."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        if self.template:
            from carecontact.lab.calibration.trial import template

            print(template(), end="")
            return 0
        if not self.trials:
            raise ConfigError(
                "TRIALS.csv is missing; name one or more files of measured trials (--template prints one)"
            )
        if self.verify is not None:
            return _verify(self.trials, self.verify)
        from carecontact.lab.calibration.calibrate import calibrate
        from carecontact.lab.calibration.checks import regions_of
        from carecontact.plotting import import_matplotlib

        import_matplotlib()

        rules = self.rules.load()
        for region in self.region:
            if region not in rules.soft_regions:
                raise ConfigError(
                    f"--region {region!r} is not a soft region of {rules.id}; valid: {', '.join(rules.soft_regions)}"
                )
        setup, regions = self._setup(), tuple(dict.fromkeys(self.region))
        if len(regions) != 1:
            regions = regions_of(self.trials, setup, valid=regions or rules.soft_regions)
        began = time.monotonic()

        def show(line: str) -> None:
            print(f"{time.monotonic() - began:6.0f} s  {line}", flush=True)

        made = calibrate(
            self.trials, regions=regions, setup=setup, body=self.body, rules=rules, out=self.out, on_progress=show
        )
        for certificate in made.certificates:
            _show(certificate.content)
        for path in made.written:
            print(path)
        for certificate in made.certificates:
            _print_verdict(certificate.content)
        return 0 if all(one.content.verdict == "accepted" for one in made.certificates) else 1

    def _setup(self) -> Setup:
        from carecontact.lab.calibration.trial import Setup, read_setup

        stated: dict[str, Any] = {}
        if self.indenter is not None:
            shape, _, radius = self.indenter.partition(":")
            size = (
                {"indenter_size_mm": _number("--indenter", self.indenter, radius)} if radius or shape != "cap" else {}
            )
            stated |= {"indenter_shape": shape, **size}
        if self.at is not None:
            parts = self.at.split(",")
            if len(parts) not in (2, 3):
                raise ConfigError(f"--at {self.at!r}: expected ALONG,ACROSS or ALONG,ACROSS,TILT, such as 20,-4")
            names = ("along_mm", "across_mm", "tilt_deg")
            stated |= {name: _number("--at", self.at, part) for name, part in zip(names, parts, strict=False)}
        file = {} if self.setup is None else read_setup(self.setup).model_dump(exclude_none=True)
        return Setup.checked({**file, **stated}, place="--indenter, --at")


def _number(option: str, given: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(
            f"{option} {given!r}: {text!r} is not a number; such as --indenter flat:10.7 --at 20,-4"
        ) from None


def _verify(trials: Sequence[Path], path: Path) -> int:
    from carecontact.lab.calibration.certificate import read_certificate
    from carecontact.lab.calibration.verify import verify

    certificate = read_certificate(path)
    checks = verify(trials, certificate)
    table = plain_table("", "certified", "here", "result", left=("certified", "here", "result"))
    for check in checks:
        verdict = ("ok" if check.fine else "FAIL") if check.decides else ("same" if check.fine else "differs")
        table.add_row(check.name, check.certified, check.here, verdict)
    console(120).print(table)
    failed = [check for check in checks if check.decides and not check.fine]
    print(f"the certificate was {'not ' if failed else ''}reproduced on this machine")
    _print_verdict(certificate.content)
    return 1 if failed or certificate.content.verdict == "rejected" else 0


def _print_verdict(content: Content) -> None:
    print(f"the calibration of the {content.region.replace('_', ' ')} was {content.verdict}")
    for reason in content.reasons:
        print(f"  {reason}")
    if content.reasons:
        print("  run refuses this tissue unless you give --allow-rejected, and every report then says so")


def _show(content: Content) -> None:
    from carecontact.lab.calibration.certificate import beyond

    def table(title: str, *headers: str) -> Table:
        made = plain_table(*headers)
        made.title = title
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
    errors = table("simulation against trials", "", "fit", "95 % interval", "held out", "95 % interval", "limit", "")
    for name, label in {**PERCENT, "r2": "R2"}.items():
        style = {"nrmse": ".1%", "r2": ".3f"}.get(name, "+.1%")
        held = content.held_out[name] if content.held_out else None
        limit = f"{content.limits[name]:.0%}" if name in content.limits else ""
        met = "" if held is None or not limit or held.value is None else "FAIL" if beyond(name, held.value) else "pass"
        row = _numbers(content.agreement[name], style)
        errors.add_row(label, *row, *(("-", "-") if held is None else _numbers(held, style)), limit, met)
    of = "held-out trials" if content.held_out else "the fit"
    speeds = table(f"errors of {of} by speed", "speed [mm/s]", "trials", "NRMSE", "tangent stiffness", "work lost")
    for one in content.speeds:
        work = "-" if one.work_error is None else f"{one.work_error:+.1%}"
        speeds.add_row(f"{one.speed_mm_s:g}", str(one.trials), f"{one.nrmse:.1%}", f"{one.tangent_error:+.1%}", work)
    terminal = console(120)
    for one in (laws, fitted, errors, speeds):
        terminal.print(one)
        terminal.print()
    for note in content.notes:
        terminal.print(f"note: {note}")


def _numbers(value: Value, style: str) -> tuple[str, str]:
    middle = "not identified" if value.value is None else format(value.value, style)
    if value.ci95 is None:
        return middle, "-"
    low, high = value.ci95
    return middle, f"{low:{style}} to {high:{style}}"
