"""``carecontact validate``: is the simulated person physically valid?"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import ConfigError
from carecontact.protocols import adapted, load_protocol

if TYPE_CHECKING:
    from rich.table import Table

    from carecontact.validation.result import CheckResult, Measure
    from carecontact.validation.run import Validation


def validate(
    *,
    bodies: tuple[str, ...],
    tissue: str | None = None,
    fast: bool = False,
    quick: bool,
    checks: str,
    protocol: str,
    out: Path,
    verbose: bool,
) -> int:
    """Exit status 1 if any check fails on any body."""
    from rich.console import Console

    from carecontact.validation.run import CHECKS, write
    from carecontact.validation.run import validate as run_checks
    from carecontact.world.human.library import load_body

    rules = adapted(load_protocol(protocol), tissue=tissue, fast=fast)
    names = tuple(CHECKS) if checks == "all" else tuple(part.strip() for part in checks.split(","))
    if not all(names) or len(set(names)) != len(names):
        raise ConfigError(
            f"--checks {checks!r}: expected names parted by commas, each once; valid: {', '.join(CHECKS)}"
        )
    wanted = bodies or (rules.person.body,)
    for body in wanted:
        load_body(body)
    console = Console(highlight=False, width=None if Console().is_terminal else 140)
    passed = True
    for body in wanted:
        title = f"{rules.title}, tissue {rules.person.tissue_set}"
        console.print(f"{body}, {title}{', quick' if quick else ''}", style="bold")

        # A body may be a file: its name as a folder keeps letters and digits only.
        folder = out / re.sub(r"[^A-Za-z0-9_-]+", "_", body) if len(wanted) > 1 else out

        def keep(so_far: Validation, folder: Path = folder) -> None:
            console.print(_line(so_far.results[-1]))
            write(so_far, folder)

        validation = run_checks(rules, body=body, quick=quick, checks=names, on_check=keep)
        missed = [(result, measure) for result in validation.results for measure in result.missed]
        if verbose or missed:
            rows = [(r, m) for r in validation.results for m in r.measures] if verbose else missed
            console.print(_table(rows))
        some = "" if len(names) == len(CHECKS) else f" ({len(names)} of {len(CHECKS)} checks)"
        print(f"{'passed' if validation.passed else 'FAILED'}{some}: {folder / 'validation.json'}")
        passed &= validation.passed
    return 0 if passed else 1


def _line(result: CheckResult) -> str:
    colour = "green" if result.passed else "red"
    lines = [m for m in result.measures if m.limit is not None and m.decides]
    told = result.error or f"{sum(bool(m.met) for m in lines)} of {len(lines)} lines met"
    return f"  [{colour}]{'pass' if result.passed else 'FAIL'}[/{colour}]  {result.title:<42} {told}"


def _table(rows: list[tuple[CheckResult, Measure]]) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("check", "measured", "value", "line", ""):
        table.add_column(header, justify="right" if header in ("value", "line") else "left")
    for result, measure in rows:
        limit = "" if measure.limit is None else f"{measure.side} {measure.limit:g} {measure.unit}"
        verdict = {None: "", True: "[green]met[/green]", False: "[red]missed[/red]"}[measure.met]
        if measure.met is not None and not measure.decides:
            verdict = f"{'met' if measure.met else 'not met'}, reported"
        table.add_row(result.check, measure.name, f"{measure.value:.3g} {measure.unit}", limit, verdict)
    return table
