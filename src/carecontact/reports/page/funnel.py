"""Success, then on the right region, then within the force gate: counts, Wilson intervals and their drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carecontact.reports.table import percent
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import wilson_interval

WIDTH, ROW, LEFT, RIGHT, BOTTOM = 680, 58, 1, 1, 30


@dataclass(frozen=True, kw_only=True)
class Step:
    name: str
    meaning: str
    k: int
    n: int
    low: float
    high: float
    """Wilson 95 % interval, as fractions."""


def funnel(scores: Sequence[TrialScore]) -> list[Step]:
    """Three steps, each a subset of the one before; empty without a trial that is ``judged``."""
    scores = judged(scores)
    if not scores:
        return []
    steps = (
        ("Success", "the task's own gate was met", sum(s.c3_success for s in scores)),
        ("Region-correct", "and on the named region", sum(s.region_correct for s in scores)),
        ("Safety-gated", "and within the force gate on every segment", sum(s.safety_gated for s in scores)),
    )
    out: list[Step] = []
    for name, meaning, k in steps:
        interval = wilson_interval(k, len(scores))
        out.append(Step(name=name, meaning=meaning, k=k, n=len(scores), low=interval.low, high=interval.high))
    return out


def funnel_svg(steps: Sequence[Step]) -> str:
    """Bars of the observed rates with the interval as a whisker, on a 0-100 % axis."""
    height = ROW * len(steps) + BOTTOM
    width = WIDTH - LEFT - RIGHT
    alt = "; ".join(f"{s.name} {s.k} of {s.n}, 95 % interval {percent(s.low)} to {percent(s.high)}" for s in steps)
    out = [f'<svg class="funnel" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{alt}">']
    bottom = ROW * len(steps)
    for share, anchor in ((0, "start"), (25, "middle"), (50, "middle"), (75, "middle"), (100, "end")):
        x = LEFT + width * share / 100
        out.append(f'<text class="label" x="{x:.1f}" y="{bottom + 22}" text-anchor="{anchor}">{share} %</text>')
    for i, step in enumerate(steps):
        y = ROW * i + 30
        x, low, high = (LEFT + width * v for v in (step.k / step.n, step.low, step.high))
        middle = y + 8
        out.append(f'<text class="name" x="{LEFT}" y="{y - 8}">{step.name}<tspan class="meaning" dx="8">')
        out.append(f"{step.meaning}</tspan></text>")
        out.append(f'<text class="name" x="{LEFT + width}" y="{y - 8}" text-anchor="end">{step.k} of {step.n}')
        out.append(f'<tspan class="meaning" dx="8">({percent(step.low)} to {percent(step.high)})</tspan></text>')
        out.append(f'<rect class="rail" x="{LEFT}" y="{y}" width="{width}" height="16" rx="2"/>')
        grid = "".join(f"M{LEFT + width * share / 100:.1f} {y}v16" for share in (25, 50, 75))
        out.append(f'<path class="tick" d="{grid}"/>')
        if step.k:
            out.append(f'<rect class="bar bar{i}" x="{LEFT}" y="{y}" width="{x - LEFT:.1f}" height="16" rx="2"/>')
        whisker = f"M{low:.1f} {middle}H{high:.1f}M{low:.1f} {middle - 5}v10M{high:.1f} {middle - 5}v10"
        out.append(f'<path class="halo" d="{whisker}"/><path class="whisker" d="{whisker}"/>')
    return "".join(out) + "</svg>"
