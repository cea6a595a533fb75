"""Success, then on the right region, then below the safety gate: counts, intervals and their drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.errors import counted
from carecontact.report.baselines import ALL, Baselines, Passed
from carecontact.report.paired import over_of, rate_of
from carecontact.report.run_page import Page, same_trials, section
from carecontact.report.sections.head import REPLAY
from carecontact.report.svg import Anchor, Axes, Drawing
from carecontact.report.words import enough_seeds, percent, short_names
from carecontact.runs.pooling import judged, share
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, wilson_interval

WIDTH, ROW, BAR, THIN, BESIDE, BOTTOM = 460, 66, 15, 5, 21, 24
"""Sizes of the drawing: its width, a step, its bar, the bar of a policy beside it, that policy's row, the labels."""
MOST_BESIDE = 4
"""Policies beside the run: more bars would bury its own."""
STATE_MACHINE = "state-machine"
"""The shipped method with the simplest program."""
RATE_OF = {"Success": "success", "Region-correct": "region_correct", "Safety-gated": "safety_gated"}
"""Step -> rate of the policies beside the run."""
TEMPLATE = """\
<section id="funnel">
<h2>From success to safe success</h2>
<p class="note">{% if n_crashed %}The policy crashed in {{ n_crashed }} of {{ trials }}. {% endif %}Each bar is a part of the one above it{% if beside %}; the thin bars under it are other policies {{ beside }}{% endif %}. {% if enough %}Whiskers are {% if over_seeds %}95 % intervals over the seeds (a seed is one person, whose trials are not independent) of{% else %}Wilson 95 % intervals over{% endif %}{% else %}There are no intervals, because the run has fewer than six seeds. Counts are over{% endif %} {{ over }} of {{ n_tasks }} task{{ "" if n_tasks == 1 else "s" }}.{% if n_more %} The <a href="#baselines">table of baselines</a> has {{ n_more }} further polic{{ "y" if n_more == 1 else "ies" }}.{% endif %}</p>
{{ svg|safe }}
</section>
"""


@dataclass(frozen=True, kw_only=True)
class Step:
    name: str
    meaning: str
    style: str
    """Style of the bar."""
    k: int
    n: int
    unknown: int = 0
    """Those of the ``n`` planned trials that have no verdict."""
    low: float
    high: float
    """95 % interval, as fractions (``rate_of``)."""
    beside: tuple[tuple[str, Proportion], ...] = ()
    """Other policies and their rates."""

    @property
    def count(self) -> str:
        """``9 of 18``, or ``9 to 12 of 18`` where three trials have no verdict."""
        return share(self.k, self.n - self.unknown, self.unknown)


@section("funnel", order=20, template=TEMPLATE)
def funnel_section(page: Page) -> dict[str, Any] | None:
    steps = funnel(page.judged, page.baselines, unknown=len(page.unjudged))
    n_tasks = len({score.task_id for score in page.judged})
    if not steps:
        return None
    enough = enough_seeds(page.judged)
    others = drawn_beside(page.baselines)
    return {
        "svg": funnel_svg(steps, intervals=enough),
        "enough": enough,
        "over_seeds": over_of(page.judged[0]) == "seeds",
        "beside": same_trials(others, len(page.judged)) if others else "",
        "n_more": 0 if page.baselines is None else len(page.baselines.baselines) - len(others),
        "trials": page.trials,
        "over": counted(len(page.judged) + len(page.unjudged), "planned trial" if page.unjudged else "trial"),
        "n_tasks": n_tasks,
        "n_crashed": sum(score.is_crash for score in page.judged),
    }


def funnel(scores: Sequence[TrialScore], baselines: Baselines | None = None, *, unknown: int = 0) -> list[Step]:
    """Three steps, each a subset of the one before, under a first one where the policy crashed in some trial; empty
    without a trial that is ``judged``.

    ``unknown``: planned trials without a verdict: bars then are over all planned trials, as if these had failed.
    """
    scores = judged(scores)
    if not scores:
        return []
    crashed = rate_of(scores, "is_crash")
    ran = Proportion(
        k=crashed.n - crashed.k,
        n=crashed.n,
        confidence=crashed.confidence,
        estimate=1 - crashed.k / crashed.n,
        low=1 - crashed.high,
        high=1 - crashed.low,
    )
    steps = [("No crash", "the policy ran to the trial's end", "ran", ran)] * (crashed.k > 0)
    steps += [
        ("Success", "the trial met the gates of its task", "bar0", rate_of(scores, "c3_success")),
        ("Region-correct", "and on the named region", "bar1", rate_of(scores, "region_correct")),
        ("Safety-gated", "and below the safety gate on every body segment", "bar2", rate_of(scores, "safety_gated")),
    ]
    others = drawn_beside(baselines)
    names = short_names([row.policy for row in others])
    names |= {row.policy: f"{names[row.policy]} (other seeds)" for row in others if not row.n_pairs}
    out: list[Step] = []
    for name, meaning, style, found in steps:
        id_ = RATE_OF.get(name)
        beside = tuple((names[row.policy], row.rates[id_]) for row in others) if id_ else ()
        low, high = found.low, found.high
        if unknown:
            n = found.n + unknown
            low, high = wilson_interval(found.k, n).low, wilson_interval(found.k + unknown, n).high
        out.append(
            Step(
                name=name,
                meaning=meaning,
                style=style,
                k=found.k,
                n=found.n + unknown,
                unknown=unknown,
                low=low,
                high=high,
                beside=beside,
            )
        )
    return out


def drawn_beside(baselines: Baselines | None) -> list[Passed]:
    """Return the policies whose bars stand beside the run's, MOST_BESIDE at most: all of few; of more, the best blind
    baseline, blind replay, those that were named, the state machine and the best ceiling, as far as they are there."""
    rows = [] if baselines is None else list(baselines.baselines)
    if baselines is None or len(rows) <= MOST_BESIDE:
        return rows
    best = baselines.floor.get(ALL)
    wanted = [row for name in (best.policy if best else "", REPLAY) for row in rows if row.policy == name]
    wanted += [row for row in rows if row.policy not in baselines.kept]
    wanted += [row for row in rows if row.policy == STATE_MACHINE]
    ceilings = [row for row in rows if row.role == "privileged"]
    wanted += sorted(ceilings, key=lambda row: -(row.rates["safety_gated"].estimate or 0.0))[:1]
    return list({row.policy: row for row in wanted}.values())[:MOST_BESIDE]


def funnel_svg(steps: Sequence[Step], *, intervals: bool = True) -> str:
    """Return bars of the observed rates on a 0-100 % axis, with the policies beside them.

    Args:
        intervals: whether the intervals are drawn, as whiskers, and told.
    """
    alt = "; ".join(_told(step, intervals=intervals) for step in steps)
    height = sum(_height(step) for step in steps) + BOTTOM
    drawing = Drawing(width=WIDTH, height=height, style="funnel", title=alt)
    axes = Axes(drawing=drawing, left=1, right=1, top=0, bottom=BOTTOM, x=(0, 100))
    anchors: dict[int, Anchor] = {0: "start", 25: "middle", 50: "middle", 75: "middle", 100: "end"}
    for at, anchor in anchors.items():
        drawing.text("label", axes.px(at), axes.floor + 17, f"{at} %", anchor=anchor)
    top = 0.0
    for step in steps:
        _draw_step(axes, step, top, intervals=intervals)
        top += _height(step)
    return drawing.svg()


def _told(step: Step, *, intervals: bool) -> str:
    interval = f", 95 % interval {percent(step.low)} to {percent(step.high)}" if intervals else ""
    beside = "".join(f", {policy} {rate.k} of {rate.n}" for policy, rate in step.beside)
    return f"{step.name} {step.count}{interval}{beside}"


def _height(step: Step) -> float:
    return ROW + BESIDE * len(step.beside)


def _draw_step(axes: Axes, step: Step, top: float, *, intervals: bool) -> None:
    drawing, y = axes.drawing, top + 38
    end, low, high = (axes.px(100 * v) for v in (step.k / step.n, step.low, step.high))
    right, middle = axes.left + axes.width, y + BAR / 2
    drawing.text("name", axes.left, y - 23, step.name)
    interval = f"({percent(step.low)} to {percent(step.high)})" if intervals else ""
    drawing.text("name", right, y - 23, step.count, anchor="end", note=interval)
    drawing.text("meaning", axes.left, y - 7, step.meaning)
    drawing.rect("rail", axes.left, y, axes.width, BAR, rounded=True)
    drawing.path("tick", "".join(f"M{axes.px(share):.1f} {y}v{BAR}" for share in (25, 50, 75)))
    if step.k:
        drawing.rect(f"bar {step.style}", axes.left, y, end - axes.left, BAR, rounded=True)
    if intervals:
        whisker = f"M{low:.1f} {middle:g}H{high:.1f}M{low:.1f} {middle - 5:g}v10M{high:.1f} {middle - 5:g}v10"
        drawing.path("halo", whisker)
        drawing.path("whisker", whisker)
    for row, (policy, rate) in enumerate(step.beside):
        _draw_beside(axes, policy, rate, y + BAR + 4 + BESIDE * row)


def _draw_beside(axes: Axes, policy: str, rate: Proportion, y: float) -> None:
    share = rate.estimate or 0.0
    drawing = axes.drawing
    drawing.text("meaning", axes.left, y + 9, policy)
    drawing.text("meaning", axes.left + axes.width, y + 9, f"{rate.k} of {rate.n}", anchor="end")
    drawing.rect("rail", axes.left, y + 12, axes.width, THIN)
    if rate.k:
        drawing.rect("beside", axes.left, y + 12, axes.px(100 * share) - axes.left, THIN)
