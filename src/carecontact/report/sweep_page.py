"""The page of a sweep, with its figure of success over levels."""

from __future__ import annotations

from pathlib import Path

from carecontact.recording.file import replace_file
from carecontact.report.run_page import render
from carecontact.report.svg import Axes, Drawing
from carecontact.report.sweep_levels import Ladder
from carecontact.report.sweep_table import PASSED, SweepTable
from carecontact.report.sweep_texts import (
    NOTES,
    ORDER_HEADS,
    as_csv,
    as_markdown,
    axis_table,
    cells,
    heads,
    level_name,
    level_tables,
    order_cells,
    provenance,
    sentences,
)
from carecontact.report.words import enough
from carecontact.stats.persons import RESAMPLES

# The figure of success over levels.
#
# Classes used: ``tick``, ``label``, ``name``, and ``line``, ``dot`` and ``whisker`` together with the classes of
# ``style_of``.

COLOURS = 6
"""Number of colours of the style sheet; a seventh policy has the colour of the first one again."""
MARKS = (
    "m-3.2 0a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0 -6.4 0z",
    "m-3 -3h6v6h-6z",
    "m0 -4.2l3.9 6.8h-7.8z",
    "m0 -4.6l4.2 4.6l-4.2 4.6l-4.2 -4.6z",
    "m0 4.2l3.9 -6.8h-7.8z",
    "m-1.3 -4h2.6v2.7h2.7v2.6h-2.7v2.7h-2.6v-2.7h-2.7v-2.6h2.7z",
    "m-3.6 -3.9h7.2l-7.2 7.8h7.2z",
)
"""Outlines [px] around a point: the figure's policies take turns. Lines of one colour differ by them."""
BESIDE = 0.035
"""Distance between the points of neighbouring policies, as a share of the distance between levels, so that their
intervals stay apart."""


def curve_svg(found: Ladder) -> str:
    """Rate over level, a line for each policy with its interval at every level."""
    n, policies = len(found.rungs), found.with_trials
    counts = "; ".join(
        f"{rung.value}: " + ", ".join(f"{c.policy} {c.rate.k} of {c.rate.n}" for c in rung.climbs if c.rate.n)
        for rung in found.rungs
    )
    drawing = Drawing(width=440, height=270, style="curve", title=f"Success over level. {counts}")
    axes = Axes(drawing=drawing, left=40, right=16, top=12, bottom=26, x=(-0.3, n - 0.7))
    axes.y_ticks((share / 100, f"{share} %") for share in (0, 25, 50, 75, 100))
    axes.x_labels([(k, short(rung.value)) for k, rung in enumerate(found.rungs)], style="name")
    for number, policy in enumerate(policies):
        aside, style = BESIDE * (number - (len(policies) - 1) / 2), style_of(found, policy)
        climbs = [(k + aside, c) for k, rung in enumerate(found.rungs) for c in rung.climbs if c.policy == policy]
        rates = [(x, c.rate.estimate, c.rate) for x, c in climbs if c.rate.estimate is not None]
        drawing.polyline(f"line {style}", [axes.point(x, estimate) for x, estimate, _ in rates])
        for x, estimate, rate in rates:
            if enough(rate.persons):
                drawing.path(f"whisker {style}", f"M{axes.px(x):.1f} {axes.py(rate.high):.1f}V{axes.py(rate.low):.1f}")
            drawing.path(f"dot {style}", mark(found, policy, *axes.point(x, estimate)))
    return drawing.svg()


def style_of(found: Ladder, policy: str) -> str:
    """Classes of a policy's line: its role, and a colour of its own for a method or a probe."""
    role = next(climb.role for climb in found.rungs[0].climbs if climb.policy == policy)
    coloured = [c.policy for c in found.rungs[0].climbs if c.role in ("method", "probe")]
    return f"{role} c{coloured.index(policy) % COLOURS}" if policy in coloured else role


def mark(found: Ladder, policy: str, x: float, y: float) -> str:
    """Path data of a policy's mark around a point [px]."""
    return f"M{x:.1f} {y:.1f}{MARKS[found.policies.index(policy) % len(MARKS)]}"


def short(value: str) -> str:
    """Return a level as the figure names it: ``L2`` of ``bathing-wide-v2 L2``, the stem of a file."""
    return level_name(value).rsplit(" ", 1)[-1]


NAMES = ("sweep.html", "sweep.md", "sweep.csv")


def write_sweep(folder: Path, table: SweepTable) -> list[Path]:
    """Write the page, the Markdown and the CSV file; the same table gives the same bytes. Returns their paths."""
    contents = (_page(table), as_markdown(table), as_csv(table))
    paths = [folder / name for name in NAMES]
    for path, content in zip(paths, contents, strict=True):
        replace_file(path, content.encode("utf-8", errors="replace"))
    return paths


def _page(table: SweepTable) -> str:
    found = table.stability
    return render(
        "sweep.html.j2",
        table=table,
        sentences=sentences(table),
        order_heads=ORDER_HEADS,
        orders=[order_cells(order) for order in found.orders] if found else [],
        resamples=f"{RESAMPLES:,}",
        passed=PASSED[table.rank_by],
        along=axis_table(table),
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
