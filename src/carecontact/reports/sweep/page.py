"""The table of a sweep as one self-contained page, and its files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

from carecontact import __version__
from carecontact.recording.writer import replace_file
from carecontact.reports.sweep.curve import curve_svg, mark, style_of
from carecontact.reports.sweep.ladder import Ladder
from carecontact.reports.sweep.notes import NOTES
from carecontact.reports.sweep.provenance import provenance
from carecontact.reports.sweep.table import PASSED, SweepTable
from carecontact.reports.sweep.texts import (
    ORDER_HEADS,
    as_csv,
    as_markdown,
    cells,
    heads,
    level_tables,
    marginal_heads,
    marginal_rows,
    order_cells,
    sentences,
)
from carecontact.stats.bootstrap import RESAMPLES

NAMES = ("sweep.html", "sweep.md", "sweep.csv")


def write_sweep(folder: Path, table: SweepTable) -> list[Path]:
    """Write the page, the Markdown and the CSV file; the same table gives the same bytes. Returns their paths."""
    contents = (_page(table), as_markdown(table), as_csv(table))
    paths = [folder / name for name in NAMES]
    for path, content in zip(paths, contents, strict=True):
        replace_file(path, content.encode("utf-8", errors="replace"))
    return paths


def _page(table: SweepTable) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment: Any = Environment(
        loader=PackageLoader("carecontact.reports.sweep"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    css = resources.files("carecontact.reports.page") / "templates" / "report.css"
    found = table.stability
    return environment.get_template("sweep.html.j2").render(
        table=table,
        css=css.read_text(),
        version=__version__,
        sentences=sentences(table),
        order_heads=ORDER_HEADS,
        orders=[order_cells(order) for order in found.orders] if found else [],
        resamples=f"{RESAMPLES:,}",
        passed=PASSED[table.rank_by],
        marginal_heads=marginal_heads(table),
        marginals=marginal_rows(table),
        curve=None if table.ladder is None else curve_svg(table.ladder),
        legend=[] if table.ladder is None else _legend(table.ladder),
        level_tables=[(title, NOTES[title], *rest) for title, *rest in level_tables(table)],
        heads=heads(table),
        left=1 + len(table.axes),
        cells=[(row.cell.folder, cells(row)) for row in table.rows],
        provenance=provenance(table),
    )


def _legend(ladder: Ladder) -> list[tuple[str, str, str]]:
    """Name, classes and mark of each policy that has trials; the mark is in the middle of 26 x 12 pixels."""
    return [(name, style_of(ladder, name), mark(ladder, name, 13, 6)) for name in ladder.with_trials]
