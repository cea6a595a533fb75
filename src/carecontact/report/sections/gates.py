"""Sections about limits and gates: safety beside success, and how much a result depends on gates that were chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.protocol.protocol import Protocol
from carecontact.report.failures import only_crashes
from carecontact.report.run_page import FOLD, Page, section
from carecontact.report.svg import Axes, Drawing
from carecontact.report.tables import limit_rows
from carecontact.report.words import enough_seeds, joint_counts
from carecontact.runs.pooling import judged
from carecontact.runs.results_file import GAMMAS, LEVELS, gamma_sweep, gate_sweep, quadrants
from carecontact.scoring.gate_sweep import own_value, sweeps_of
from carecontact.scoring.limits import footnote
from carecontact.scoring.result import TrialScore
from carecontact.stats import wilson_interval

RADIUS = (6.0, 4.2, 2.4)
"""Radii of the dots of success, region-correct and safety-gated: each is part of the one before, so that equal counts
show as rings."""


@section("safety", "Safe, and successful?", order=FOLD + 30)
def safety(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    rows = limit_rows(page.judged, gamma=page.gamma, unknown=len(page.unjudged))
    return {
        "trials": page.trials,
        "enough": enough_seeds(page.judged),
        "quadrants": quadrants(page.judged),
        "crashed_over": sum(score.is_crash and bool(score.over_limit) for score in page.judged),
        "untouched": sum(score.crashed_untouched for score in page.judged),
        "joints": joint_counts(page.judged),
        "limit_rows": rows,
        "footnote": footnote(row.name for row in rows),
    }


@dataclass(frozen=True, kw_only=True)
class Panel:
    title: str
    n: int
    """Trials that the gate applies to."""
    svg: str
    """Empty where nothing depends on the gate."""
    flat: str
    """What is the same at all values; empty where something depends on the gate."""


@section("gates", "How much depends on the gates", order=FOLD + 50)
def gates(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    panels = [gamma_panel(page.judged, page.gamma), *gate_panels(page.judged, page.protocol)]
    return {
        "trials": page.trials if page.unjudged else "",
        "enough": enough_seeds(page.judged),
        "gamma_svg": panels[0].svg,
        "flat": [panel for panel in panels if panel.flat],
        "panels": [panel for panel in panels[1:] if not panel.flat],
    }


def gamma_panel(scores: Sequence[TrialScore], gamma: float | None) -> Panel:
    """Return the share of safety-gated trials over the discount gamma'; the protocol's own is marked."""
    counted = judged(scores)
    rows = gamma_sweep(counted)
    first, last = rows[0]["safety_gated"], rows[-1]["safety_gated"]
    flat = f"the same from {GAMMAS[0]:g} to {GAMMAS[-1]:g}: {first} safety-gated of {len(counted)}"
    svg = "" if first == last else gamma_svg(counted, gamma=gamma)
    return Panel(title="γ′, allowed share of the pain limit", n=len(counted), svg=svg, flat=flat * (not svg))


def gamma_axes(title: str) -> Axes:
    """Share of the trials [1] over the discount gamma'."""
    drawing = Drawing(width=460, height=220, style="sweep", title=title)
    return Axes(drawing=drawing, left=44, right=16, top=26, bottom=44, x=(GAMMAS[0], GAMMAS[-1]))


def gamma_svg(counted: Sequence[TrialScore], *, gamma: float | None) -> str:
    """Draw the share over gamma', with its Wilson interval where there are enough seeds."""
    n, rows = len(counted), gamma_sweep(counted)
    ends = f"{rows[0]['safety_gated']} of {n} at {GAMMAS[0]:g}, {rows[-1]['safety_gated']} at {GAMMAS[-1]:g}"
    axes = gamma_axes(f"Safety-gated trials over the discount γ′: {ends}")
    drawing, right = axes.drawing, axes.left + axes.width
    axes.y_ticks((share / 100, f"{share} %") for share in (0, 25, 50, 75, 100))
    axes.x_labels((value, f"{value:.1f}") for value in (0.2, 0.4, 0.6, 0.8, 1.0))
    meaning = "γ′, share of the pain limit that the force in a trial may reach"
    drawing.text("label", axes.left + axes.width / 2, axes.floor + 34, meaning, anchor="middle")
    if enough_seeds(counted):
        bounds = [(row["gamma"], wilson_interval(row["safety_gated"], n)) for row in rows]
        upper = [axes.point(x, interval.high) for x, interval in bounds]
        drawing.polygon("band", upper + [axes.point(x, interval.low) for x, interval in reversed(bounds)])
    correct = sum(s.region_correct for s in counted)
    axes.across("ceiling", correct / n)
    drawing.polyline("level2", [axes.point(row["gamma"], row["safety_gated"] / n) for row in rows])
    drawing.text("label", right, axes.py(correct / n) - 7, f"region-correct, {correct}", anchor="end")
    if gamma is not None:
        k = gamma_sweep(counted, [gamma])[0]["safety_gated"]
        x, y = axes.point(gamma, k / n)
        axes.upright("own", gamma)
        drawing.circle("dot2", x, y, 4)
        # The curve only rises, so that the place under it is free.
        below = y + (20 if y < axes.floor - 26 else -9)
        drawing.text("value", x + 8, below, f"{k} of {n} at γ′ = {gamma:g}")
    return drawing.svg()


def gate_panels(scores: Sequence[TrialScore], protocol: Protocol | None) -> list[Panel]:
    """Return one small figure for each swept gate of the run's actions; the protocol's own values are marked."""
    counted = judged(scores)
    panels: list[Panel] = []
    version = counted[0].metric_versions.get("gates", "") if counted else ""
    for name, (action, sweep) in sweeps_of(sorted({s.action for s in counted}), version).items():
        of_gate = [s for s in counted if action in (None, s.action)]
        rows = gate_sweep(of_gate).get(name, [])
        if rows:
            own = None if protocol is None else own_value(protocol, action, sweep)
            title, n = f"{sweep.title} [{sweep.unit}]", len(of_gate)
            flat = ""
            if all(row[level] == rows[0][level] for row in rows for level in LEVELS):
                ends = [f"{sweep.factor * row['value']:g}" for row in (rows[0], rows[-1])]
                flat = f"the same from {ends[0]} to {ends[1]}: {_counts(rows[0])} of {n}"
            svg = "" if flat else _panel_svg(title, rows, sweep.factor, own, n)
            panels.append(Panel(title=title, n=n, svg=svg, flat=flat))
    return panels


def _counts(row: dict[str, Any]) -> str:
    return ", ".join(f"{row[level]} {level.replace('_', '-')}" for level in LEVELS)


def panel_axes(title: str, columns: int, n: int) -> Axes:
    """Return counts of ``n`` trials over evenly spaced columns: the values are a handful of choices and no scale."""
    drawing = Drawing(width=250, height=168, style="sweep", title=title)
    last = max(columns - 1, 1)
    beside = 16.0 / 174.0 * last
    return Axes(drawing=drawing, left=30, right=14, top=16, bottom=24, x=(-beside, last + beside), y=(0, n))


def _panel_svg(title: str, rows: Sequence[dict[str, Any]], factor: float, own: float | None, n: int) -> str:
    alternative = "; ".join(f"{factor * row['value']:g}: {_counts(row)}" for row in rows)
    axes = panel_axes(f"{title}, {alternative}", len(rows), n)
    axes.y_ticks((k, str(k)) for k in ((0, n // 2, n) if n % 2 == 0 else (0, n)))
    for i, row in enumerate(rows):
        chosen = own is not None and abs(row["value"] - own) < 1e-9
        if chosen:
            axes.upright("own", i)
        axes.x_labels([(i, f"{factor * row['value']:g}")], style="name" if chosen else "label")
    for depth, level in enumerate(LEVELS):
        line = [axes.point(i, row[level]) for i, row in enumerate(rows)]
        axes.drawing.polyline(f"level{depth}", line)
        for x, y in line:
            axes.drawing.circle(f"dot{depth}", x, y, RADIUS[depth])
    return axes.drawing.svg()
