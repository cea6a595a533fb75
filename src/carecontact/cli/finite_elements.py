"""The table of ``carecontact validate --fem``."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from carecontact.contract.protocol import Protocol
    from carecontact.validation.fem.compare import Comparison


def show_beside(rules: Protocol, body: str, folder: Path) -> None:
    """Print the comparison region by region and write ``fem.json`` and ``fem.png``.

    Raises DependencyError where scikit-fem is missing.
    """
    from rich.console import Console

    from carecontact.protocols import overridden
    from carecontact.validation.fem.compare import as_json, compare
    from carecontact.validation.fem.figure import draw
    from carecontact.validation.figures import draw_figure
    from carecontact.validation.subject import Subject

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

    from carecontact.validation.fem.compare import CLOSE_PERCENT

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
