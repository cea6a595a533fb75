"""Figures of how much a result depends on gates that had to be chosen.

Classes used: ``tick``, ``label``, ``band``, ``ceiling``, ``own``, ``name``, ``value``, and ``level0`` to ``level2`` and
``dot0`` to ``dot2`` for the steps of the funnel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.contract.protocol import Protocol
from carecontact.reports.intervals import enough_seeds
from carecontact.reports.svg import Axes, Drawing
from carecontact.runs.aggregate import GAMMAS, LEVELS, gamma_sweep, gate_sweep
from carecontact.runs.pooling import judged
from carecontact.scoring.gate_sweep import own_value, sweeps_of
from carecontact.scoring.result import TrialScore
from carecontact.stats import wilson_interval

RADIUS = (6.0, 4.2, 2.4)
"""Radii of the dots of the funnel's steps: a step is part of the one before, so that equal counts show as rings."""


@dataclass(frozen=True, kw_only=True)
class Panel:
    title: str
    n: int
    """Trials that the gate applies to."""
    svg: str
    """Empty where nothing depends on the gate."""
    flat: str = ""
    """What is the same at all values; empty where something depends on the gate."""


def gamma_axes(title: str) -> Axes:
    """Share of the trials [1] over the discount gamma'."""
    drawing = Drawing(width=460, height=220, style="sweep", title=title)
    return Axes(drawing=drawing, left=44, right=16, top=26, bottom=44, x=(GAMMAS[0], GAMMAS[-1]))


def gamma_svg(scores: Sequence[TrialScore], *, gamma: float | None) -> str:
    """Share of safety-gated trials over the discount gamma', with its Wilson interval where there are enough seeds;
    empty without a judged trial.

    Args:
        gamma: the protocol's own, marked; None: no mark.
    """
    counted = judged(scores)
    if not counted:
        return ""
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
        _mark_gamma(axes, gamma, sum(row["safety_gated"] for row in gamma_sweep(counted, [gamma])), n)
    return drawing.svg()


def _mark_gamma(axes: Axes, gamma: float, k: int, n: int) -> None:
    x, y = axes.point(gamma, k / n)
    axes.upright("own", gamma)
    axes.drawing.circle("dot2", x, y, 4)
    # The curve only rises, so that the place under it is free.
    below = y + (20 if y < axes.floor - 26 else -9)
    axes.drawing.text("value", x + 8, below, f"{k} of {n} at γ′ = {gamma:g}")


def gate_panels(scores: Sequence[TrialScore], protocol: Protocol | None) -> list[Panel]:
    """Return one small figure for each swept gate that some trial of the run has to pass.

    Args:
        protocol: whose own values are marked; None: no mark.
    """
    counted = judged(scores)
    panels: list[Panel] = []
    version = counted[0].metric_versions.get("gates", "") if counted else ""
    for name, (action, sweep) in sweeps_of(sorted({s.action for s in counted}), version).items():
        of_gate = [s for s in counted if action in (None, s.action)]
        rows = gate_sweep(of_gate).get(name, [])
        if not rows:
            continue
        own = None if protocol is None else own_value(protocol, action, sweep)
        title = f"{sweep.title} [{sweep.unit}]"
        flat = _flat(rows, sweep.factor, len(of_gate))
        svg = "" if flat else _panel_svg(title, rows, sweep.factor, own, len(of_gate))
        panels.append(Panel(title=title, n=len(of_gate), svg=svg, flat=flat))
    return panels


def _flat(rows: Sequence[dict[str, Any]], factor: float, n: int) -> str:
    """Return the counts, where they are the same at every value of a gate; else empty."""
    if any(row[level] != rows[0][level] for row in rows for level in LEVELS):
        return ""
    counts = ", ".join(f"{rows[0][level]} {level.replace('_', '-')}" for level in LEVELS)
    return f"the same from {factor * rows[0]['value']:g} to {factor * rows[-1]['value']:g}: {counts} of {n}"


def gamma_flat(scores: Sequence[TrialScore]) -> str:
    """Return how many trials are safety-gated, where that is the same at every discount gamma'; else empty."""
    counts = {row["safety_gated"] for row in gamma_sweep(judged(scores))}
    if len(counts) != 1:
        return ""
    return f"the same from {GAMMAS[0]:g} to {GAMMAS[-1]:g}: {counts.pop()} safety-gated of {len(judged(scores))}"


def panel_axes(title: str, columns: int, n: int) -> Axes:
    """Return counts of ``n`` trials over evenly spaced columns: the values are a handful of choices and no scale."""
    drawing = Drawing(width=250, height=168, style="sweep", title=title)
    beside = 16.0 / 174.0 * max(columns - 1, 1)
    return Axes(
        drawing=drawing, left=30, right=14, top=16, bottom=24, x=(-beside, max(columns - 1, 1) + beside), y=(0, n)
    )


def _panel_svg(title: str, rows: Sequence[dict[str, Any]], factor: float, own: float | None, n: int) -> str:
    told = "; ".join(
        f"{factor * row['value']:g}: " + ", ".join(f"{row[level]} {level.replace('_', '-')}" for level in LEVELS)
        for row in rows
    )
    axes = panel_axes(f"{title}, {told}", len(rows), n)
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
