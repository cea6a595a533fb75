"""How much of a result depends on gates that had to be chosen, as inline SVG coloured by the page's style sheet.

Classes used: ``axis``, ``tick``, ``label``, ``band``, ``ceiling``, ``own``, ``name``, ``meaning`` and, for the steps of
the funnel, ``level0`` to ``level2``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.contract.protocol import Protocol
from carecontact.runs.aggregate import GAMMAS, LEVELS, gamma_sweep, gate_sweep
from carecontact.runs.pooling import judged
from carecontact.scoring.behaviour import sweeps_of
from carecontact.scoring.gate_sweep import FLOOR, own_value
from carecontact.scoring.result import TrialScore
from carecontact.stats import wilson_interval

WIDTH, HEIGHT = 680, 250
LEFT, RIGHT, TOP, BOTTOM = 44, 16, 26, 44
PANEL_WIDTH, PANEL_HEIGHT = 250, 168
PANEL_LEFT, PANEL_RIGHT, PANEL_TOP, PANEL_BOTTOM = 30, 14, 16, 24
RADIUS = (6.0, 4.2, 2.4)
"""Of the funnel's steps: a step is part of the one before, so equal counts show as rings."""


@dataclass(frozen=True, kw_only=True)
class Panel:
    title: str
    n: int
    """Trials that the gate applies to."""
    svg: str


def gamma_svg(scores: Sequence[TrialScore], *, gamma: float | None) -> str:
    """Share of safety-gated runs over the discount gamma', with its Wilson interval; empty without a judged trial.

    Args:
        gamma: the protocol's own, marked; None: no mark.
    """
    counted = judged(scores)
    if not counted:
        return ""
    n = len(counted)
    rows = gamma_sweep(counted)
    correct = sum(s.region_correct for s in counted)
    plot_w, plot_h = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def px(value: float) -> float:
        return LEFT + plot_w * (value - GAMMAS[0]) / (GAMMAS[-1] - GAMMAS[0])

    def py(share: float) -> float:
        return TOP + plot_h * (1 - share)

    ends = f"{rows[0]['safety_gated']} of {n} at {GAMMAS[0]:g}, {rows[-1]['safety_gated']} at {GAMMAS[-1]:g}"
    out = [
        f'<svg class="sweep" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="Safety-gated runs over the discount: {ends}">'
    ]
    for share in (0, 25, 50, 75, 100):
        y = py(share / 100)
        out.append(f'<path class="tick" d="M{LEFT} {y:.1f}h{plot_w}"/>')
        out.append(f'<text class="label" x="{LEFT - 6}" y="{y + 3.5:.1f}" text-anchor="end">{share} %</text>')
    bottom = TOP + plot_h
    out += [
        f'<text class="label" x="{px(value):.1f}" y="{bottom + 16}" text-anchor="middle">{value:.1f}</text>'
        for value in (0.2, 0.4, 0.6, 0.8, 1.0)
    ]
    out.append(
        f'<text class="label" x="{LEFT + plot_w / 2:g}" y="{bottom + 34}" text-anchor="middle">'
        "γ′, share of the pain limit that a run may reach</text>"
    )
    intervals = [wilson_interval(row["safety_gated"], n) for row in rows]
    edge = [(px(r["gamma"]), py(i.high)) for r, i in zip(rows, intervals, strict=True)]
    edge += [(px(r["gamma"]), py(i.low)) for r, i in zip(reversed(rows), reversed(intervals), strict=True)]
    out.append(f'<polygon class="band" points="{_points(edge)}"/>')
    out.append(f'<path class="ceiling" d="M{LEFT} {py(correct / n):.1f}h{plot_w}"/>')
    line = [(px(r["gamma"]), py(r["safety_gated"] / n)) for r in rows]
    out.append(f'<polyline class="level2" points="{_points(line)}"/>')
    above = py(correct / n) - 7
    out.append(
        f'<text class="label" x="{LEFT + plot_w}" y="{above:.1f}" text-anchor="end">region-correct, {correct}</text>'
    )
    if gamma is not None:
        k = sum(row["safety_gated"] for row in gamma_sweep(counted, [gamma]))
        x, y = px(gamma), py(k / n)
        out.append(
            f'<path class="own" d="M{x:.1f} {TOP}V{bottom}"/><circle class="dot2" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'
        )
        # The curve only rises, so that the place under it is free.
        at = y + (20 if y < bottom - 26 else -9)
        out.append(f'<text class="value" x="{x + 8:.1f}" y="{at:.1f}">{k} of {n} at γ′ = {gamma:g}</text>')
    return "".join(out) + "</svg>"


def gate_panels(scores: Sequence[TrialScore], protocol: Protocol | None) -> list[Panel]:
    """One small figure for each swept gate that some trial of the run has to pass.

    Args:
        protocol: whose own values are marked; None: no mark.
    """
    counted = judged(scores)
    panels: list[Panel] = []
    sweeps = {FLOOR.name: (None, FLOOR), **sweeps_of(sorted({s.action for s in counted}))}
    for name, (action, sweep) in sweeps.items():
        of_gate = [s for s in counted if action in (None, s.action)]
        rows = gate_sweep(of_gate).get(name, [])
        if not rows:
            continue
        own = None if protocol is None else own_value(protocol, action, sweep)
        title = f"{sweep.title} [{sweep.unit}]"
        panels.append(Panel(title=title, n=len(of_gate), svg=_panel_svg(title, rows, sweep.factor, own, len(of_gate))))
    return panels


def _panel_svg(title: str, rows: Sequence[dict[str, Any]], factor: float, own: float | None, n: int) -> str:
    plot_w, plot_h = PANEL_WIDTH - PANEL_LEFT - PANEL_RIGHT, PANEL_HEIGHT - PANEL_TOP - PANEL_BOTTOM
    bottom = PANEL_TOP + plot_h
    # Evenly spaced: the values are a handful of choices and no scale.
    inset = 16.0
    step = (plot_w - 2 * inset) / max(len(rows) - 1, 1)
    xs = [PANEL_LEFT + inset + step * i for i in range(len(rows))]

    def py(k: int) -> float:
        return PANEL_TOP + plot_h * (1 - k / n)

    told = "; ".join(
        f"{factor * row['value']:g}: " + ", ".join(f"{row[level]} {level.replace('_', '-')}" for level in LEVELS)
        for row in rows
    )
    out = [f'<svg class="sweep" viewBox="0 0 {PANEL_WIDTH} {PANEL_HEIGHT}" role="img" aria-label="{title}, {told}">']
    for k in (0, n // 2, n) if n % 2 == 0 else (0, n):
        out.append(f'<path class="tick" d="M{PANEL_LEFT} {py(k):.1f}h{plot_w}"/>')
        out.append(f'<text class="label" x="{PANEL_LEFT - 5}" y="{py(k) + 3.5:.1f}" text-anchor="end">{k}</text>')
    for x, row in zip(xs, rows, strict=True):
        chosen = own is not None and abs(row["value"] - own) < 1e-9
        if chosen:
            out.append(f'<path class="own" d="M{x:.1f} {PANEL_TOP}V{bottom}"/>')
        style = "name" if chosen else "label"
        out.append(
            f'<text class="{style}" x="{x:.1f}" y="{bottom + 16}" text-anchor="middle">{factor * row["value"]:g}</text>'
        )
    for depth, level in enumerate(LEVELS):
        line = [(x, py(row[level])) for x, row in zip(xs, rows, strict=True)]
        out.append(f'<polyline class="level{depth}" points="{_points(line)}"/>')
        out += [f'<circle class="dot{depth}" cx="{x:.1f}" cy="{y:.1f}" r="{RADIUS[depth]}"/>' for x, y in line]
    return "".join(out) + "</svg>"


def _points(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
