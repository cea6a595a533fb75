"""Success, then on the right region, then below the safety gate: counts, Wilson intervals and their drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.reports.page.section import Page, section
from carecontact.reports.svg import Anchor, Axes, Drawing
from carecontact.reports.text import percent
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import wilson_interval

WIDTH, ROW, BAR, BOTTOM = 680, 58, 16, 30
TEMPLATE = """\
<section>
<h2>From success to safe success</h2>
<p class="note">{% if n_crashed %}The policy crashed in {{ n_crashed }} of {{ n }} trial{{ "" if n == 1 else "s" }}. {% endif %}Each bar is a part of the one above it. Whiskers are Wilson 95 % intervals over {{ n }} trial{{ "" if n == 1 else "s" }} of {{ n_tasks }} task{{ "" if n_tasks == 1 else "s" }}.</p>
{{ svg|safe }}
</section>
"""


@dataclass(frozen=True, kw_only=True)
class Step:
    name: str
    meaning: str
    style: str
    """Of the bar."""
    k: int
    n: int
    low: float
    high: float
    """Wilson 95 % interval, as fractions."""


@section("funnel", order=20, template=TEMPLATE)
def funnel_section(page: Page) -> dict[str, Any] | None:
    steps = funnel(page.judged)
    n_tasks = len({score.task_id for score in page.judged})
    if not steps:
        return None
    n_crashed = sum(score.is_crash for score in page.judged)
    return {"svg": funnel_svg(steps), "n": len(page.judged), "n_tasks": n_tasks, "n_crashed": n_crashed}


def funnel(scores: Sequence[TrialScore]) -> list[Step]:
    """Three steps, each a subset of the one before, under a first one where the policy crashed in some trial; empty
    without a trial that is ``judged``."""
    scores = judged(scores)
    if not scores:
        return []
    ran = sum(not s.is_crash for s in scores)
    steps = [("No crash", "the policy ran to the trial's end", "ran", ran)] * (ran < len(scores))
    steps += [
        ("Success", "the trial met the gates of its task", "bar0", sum(s.c3_success for s in scores)),
        ("Region-correct", "and on the named region", "bar1", sum(s.region_correct for s in scores)),
        (
            "Safety-gated",
            "and below the safety gate on every body segment",
            "bar2",
            sum(s.safety_gated for s in scores),
        ),
    ]
    out: list[Step] = []
    for name, meaning, style, k in steps:
        found = wilson_interval(k, len(scores))
        out.append(Step(name=name, meaning=meaning, style=style, k=k, n=len(scores), low=found.low, high=found.high))
    return out


def funnel_svg(steps: Sequence[Step]) -> str:
    """Bars of the observed rates with the interval as a whisker, on a 0-100 % axis."""
    alt = "; ".join(f"{s.name} {s.k} of {s.n}, 95 % interval {percent(s.low)} to {percent(s.high)}" for s in steps)
    drawing = Drawing(width=WIDTH, height=ROW * len(steps) + BOTTOM, style="funnel", title=alt)
    axes = Axes(drawing=drawing, left=1, right=1, top=0, bottom=BOTTOM, x=(0, 100))
    anchors: dict[int, Anchor] = {0: "start", 25: "middle", 50: "middle", 75: "middle", 100: "end"}
    for share, anchor in anchors.items():
        drawing.text("label", axes.px(share), axes.floor + 22, f"{share} %", anchor=anchor)
    for i, step in enumerate(steps):
        _draw_step(axes, step, i)
    return drawing.svg()


def _draw_step(axes: Axes, step: Step, i: int) -> None:
    drawing, y = axes.drawing, ROW * i + 30
    end, low, high = (axes.px(100 * v) for v in (step.k / step.n, step.low, step.high))
    right, middle = axes.left + axes.width, y + BAR / 2
    drawing.text("name", axes.left, y - 8, step.name, note=step.meaning)
    interval = f"({percent(step.low)} to {percent(step.high)})"
    drawing.text("name", right, y - 8, f"{step.k} of {step.n}", anchor="end", note=interval)
    drawing.rect("rail", axes.left, y, axes.width, BAR, rounded=True)
    drawing.path("tick", "".join(f"M{axes.px(share):.1f} {y}v{BAR}" for share in (25, 50, 75)))
    if step.k:
        drawing.rect(f"bar {step.style}", axes.left, y, end - axes.left, BAR, rounded=True)
    whisker = f"M{low:.1f} {middle:g}H{high:.1f}M{low:.1f} {middle - 5:g}v10M{high:.1f} {middle - 5:g}v10"
    drawing.path("halo", whisker)
    drawing.path("whisker", whisker)
