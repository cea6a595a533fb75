"""Sections about failures and safety: gates, causes, crashes, limits of pain and load on the person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.protocol.protocol import Protocol
from carecontact.recording.reason import PRINTED, TRACEBACK, alike, remedies
from carecontact.report.failures import anatomy, causes, failure_modes, only_crashes
from carecontact.report.links import shortened
from carecontact.report.run_page import Page, section
from carecontact.report.svg import Axes, Drawing
from carecontact.report.tables import POOLED, limit_rows, load, nursing_rows
from carecontact.report.words import enough_seeds, joint_counts, listed, rounded
from carecontact.runs.pooling import judged
from carecontact.runs.results_file import GAMMAS, LEVELS, gamma_sweep, gate_sweep, quadrants
from carecontact.scoring.gate_sweep import own_value, sweeps_of
from carecontact.scoring.limits import footnote
from carecontact.scoring.result import TrialScore
from carecontact.stats import wilson_interval

# Figures of how much a result depends on gates that had to be chosen.
#
# Classes used: ``tick``, ``label``, ``band``, ``ceiling``, ``own``, ``name``, ``value``, and ``level0`` to ``level2``
# and ``dot0`` to ``dot2`` for the steps of the funnel.

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


# How much a result depends on gates that had to be chosen.

GATES_TEMPLATE = """\
<section id="gates">
<h2>How much depends on the gates</h2>
<p class="note">The values of the gates are choices of the benchmark. {% if gamma_svg %}The curve is the share of safety-gated trials over the allowed share γ′ of the pain limit{% if enough %}, with its Wilson 95 % interval{% endif %}; the share of region-correct trials is its upper bound. {% endif %}{% if panels %}Each small figure shows the trials that pass with another value of one gate, and the other gates as in the protocol, over the trials to which this gate applies. {% endif %}{% if gamma_svg or panels %}A dotted line marks the protocol's own value.{% else %}None of them decides a result of this run.{% endif %}{% if trials %} All counts are of the {{ trials }}.{% endif %}</p>
{% if flat %}
<dl class="flat">
{% for title, text in flat %}
<dt>{{ title }}</dt><dd>{{ text }}</dd>
{% endfor %}
</dl>
{% endif %}
{{ gamma_svg|safe }}
{% if panels %}
<ul class="legend">
{% for name in ("success", "region-correct", "safety-gated") %}
<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="level{{ loop.index0 }}" d="M0 6h26"/><circle class="dot{{ loop.index0 }}" cx="13" cy="6" r="{{ (5, 4, 2.4)[loop.index0] }}"/></svg>{{ name }}</li>
{% endfor %}
</ul>
<div class="panels">
{% for panel in panels %}
<figure><h3>{{ panel.title }} <span>{{ panel.n }} trial{{ "" if panel.n == 1 else "s" }}</span></h3>
{{ panel.svg|safe }}</figure>
{% endfor %}
</div>
{% endif %}
</section>
"""


@section("gates", order=60, template=GATES_TEMPLATE)
def gates(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    panels, level = gate_panels(page.judged, page.protocol), gamma_flat(page.judged)
    flat = [("γ′, allowed share of the pain limit", level)] if level else []
    return {
        "trials": page.trials if page.unjudged else "",
        "enough": enough_seeds(page.judged),
        "gamma_svg": "" if level else gamma_svg(page.judged, gamma=page.gamma),
        "flat": [*flat, *((panel.title, panel.flat) for panel in panels if panel.flat)],
        "panels": [panel for panel in panels if not panel.flat],
    }


# Why trials failed: modes, causes with their evidence, and where contact fell.

FAILURES_TEMPLATE = """\
<section id="failures">
<h2>Why trials failed</h2>
{% if modes %}
<p class="note">{{ failed }} of {{ trials }} did not succeed on the named region{% if joints %}, or succeeded and moved a joint too far beyond its range{% endif %}. Each has exactly one failure mode and one cause (attribution); shares are of these {{ failed }}.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table of failure modes">
<table>
<thead><tr><th scope="col">mode</th><th scope="col">meaning</th><th scope="col" class="num">trials</th><th scope="col" class="num">share</th><th scope="col">attributed to</th></tr></thead>
<tbody>
{% for m in modes %}
<tr><th scope="row" class="keep">{{ m.mode }}</th><td>{{ m.meaning }}</td><td class="num">{{ m.count }}</td><td class="num">{{ "%.0f"|format(100 * m.count / m.of) }} %</td><td>{{ m.attribution }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
<div class="scroll" tabindex="0" role="region" aria-label="Table of causes">
<table>
<thead><tr><th scope="col">cause</th><th scope="col" class="num">trials</th><th scope="col">evidence, for example</th></tr></thead>
<tbody>
{% for cause in causes %}
<tr><th scope="row">{{ cause.name }}<br><span class="meaning">{{ cause.meaning }}</span></th><td class="num">{{ cause.count }} of {{ failed }}</td><td>{% for trial_id, text in cause.examples %}{% if not loop.first %}<br>{% endif %}<b>{{ trial_id }}</b> {{ shortened(text) }}{% endfor %}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
{% else %}
<p>No trial failed: every one succeeded on the named region.{% if unsafe %} But {{ unsafe }} of {{ trials }} did not pass safely; the <a href="#trials">table of trials</a> says why.{% endif %}</p>
{% endif %}
{% if anatomy %}
<h3 class="after">Where contact fell</h3>
<div class="scroll" tabindex="0" role="region" aria-label="Table of where contact fell">
<table>
<thead><tr><th scope="col">named region</th><th scope="col" class="num">trials</th><th scope="col" class="num">region touched</th><th scope="col" class="num">only elsewhere</th><th scope="col" class="num">no contact that counts</th><th scope="col" class="num">crashed</th><th scope="col" class="num">success</th></tr></thead>
<tbody>
{% for row in anatomy %}
<tr{% if row.region == pooled %} class="sum"{% endif %}><th scope="row">{{ row.region }}</th><td class="num">{{ row.n }}</td><td class="num">{{ row.target }}</td><td class="num">{{ row.off_target }}</td><td class="num">{{ row.none }}</td><td class="num">{{ row.process_failure }}</td><td class="num">{{ row.success }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
{% endif %}
</section>
"""


@section("failures", order=80, template=FAILURES_TEMPLATE)
def failures(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    return {
        "trials": page.trials,
        "failed": sum(score.failure_mode is not None for score in page.judged),
        "joints": any(score.failure_mode == "joint_beyond_range" for score in page.judged),
        "unsafe": sum(not score.safety_gated for score in page.judged),
        "modes": failure_modes(page.judged),
        "causes": causes(page.judged),
        "anatomy": [] if only_crashes(page.judged) else anatomy(page.judged),
        "pooled": POOLED,
        "shortened": shortened,
    }


# Trials in which the policy crashed: what was raised, and one click away the traceback and what the policy printed.

MOST = 12
"""Different crashes that the page shows."""
NO_REASON = "no reason recorded"
CRASHES_TEMPLATE = """\
<section id="crashes" class="caution crashes">
<h2>The policy crashed in {{ n_crashed }} of {{ trials }}</h2>
<p class="note">Such a trial counts as a failure and never as within the safety gate; a force above the gate before the crash counts{% if n_over %}, as in {{ n_over }} trial{{ "" if n_over == 1 else "s" }} here{% endif %}. To run {{ "it" if n_crashed == 1 else "them" }} again, give the same command with <span class="keep">--restart</span> after a change of the policy, or with <span class="keep">--retry-failed</span> if the cause lay outside it.</p>
<dl>
{% for crash in crashes %}
<dt>{{ crash.trials }}</dt>
<dd>{{ crash.reason }}{% for hint in crash.hints %}<br>{{ hint }}{% endfor %}{% if crash.held %}<details><summary>{{ crash.held }} of {{ crash.first }}</summary><pre>{{ crash.message }}</pre></details>{% endif %}</dd>
{% endfor %}
</dl>
{% if more %}
<p class="note">{{ more }} more kinds of crash are not shown; results.json has every message.</p>
{% endif %}
</section>
"""


@dataclass(frozen=True, kw_only=True)
class Crash:
    """Trials that crashed for one reason, and the whole message of the first."""

    trials: str
    first: str
    reason: str
    hints: tuple[str, ...]
    """What may help."""
    message: str
    held: str
    """What the message holds beside the reason, in words; empty where it is the reason alone."""


@section("crashes", order=15, template=CRASHES_TEMPLATE)
def crashes_section(page: Page) -> dict[str, Any] | None:
    found = crashes(page.judged)
    if not found:
        return None
    return {
        "n": len(page.judged),
        "trials": page.trials,
        "n_crashed": sum(score.is_crash for score in page.judged),
        "n_over": sum(score.is_crash and bool(score.over_limit) for score in page.judged),
        "crashes": found[:MOST],
        "more": max(len(found) - MOST, 0),
    }


def crashes(scores: Sequence[TrialScore]) -> list[Crash]:
    """Return one row for each reason, in the order of the trials."""
    groups: dict[str, list[TrialScore]] = {}
    for score in scores:
        if score.is_crash:
            groups.setdefault(alike(score.evidence or NO_REASON), []).append(score)
    return [
        Crash(
            trials=listed([score.trial_id for score in group]),
            first=group[0].trial_id,
            reason=shortened(group[0].evidence or NO_REASON),
            hints=tuple(remedies(group[0].failure_message or "")),
            message=group[0].failure_message or "",
            held=_held(group[0].failure_message or "", group[0].evidence or ""),
        )
        for group in groups.values()
    ]


def _held(message: str, reason: str) -> str:
    if message.strip() in reason:
        return ""
    said, printed, _ = message.partition(PRINTED)
    held = ["traceback" if TRACEBACK in said else "stack"] if "(most recent call last)" in said else []
    return (" and ".join([*held, *(["last output"] if printed else [])]) or "whole message").capitalize()


# Whether success and safety go together, and how many trials were above each force limit.

SAFETY_TEMPLATE = """\
<section id="safety">
<h2>Safe, and successful?</h2>
<p class="note">A successful trial can exceed the safety gate, and a failed trial can, too. {% if n == 1 %}The only trial{% else %}Each of the {{ trials }}{% endif %} is in exactly one cell; a trial without contact counts as a failure within the safety gate.{% if quadrants.crashed %} A trial in which the policy crashed is in a cell of its own: it is never within the gate, but a force above a limit before the crash counts.{% if untouched %} The table of limits leaves out {{ untouched }} trial{{ "" if untouched == 1 else "s" }} in which the policy crashed before any contact.{% endif %}{% endif %}{% if joints %} The gate for joints counts as well. Trials, failed ones too, with {{ joints }}.{% endif %}</p>
<div class="split">
<div class="quadrants" role="table" aria-label="Trials by safety and success">
<div role="row"><span></span><span role="columnheader">succeeded</span><span role="columnheader">failed</span></div>
<div role="row"><span role="rowheader">within the safety gate{{ joints and "s" }}</span><span role="cell" class="q good"><b>{{ quadrants.safe_success }}</b></span><span role="cell" class="q"><b>{{ quadrants.safe_failure }}</b></span></div>
<div role="row"><span role="rowheader">above {{ "a" if joints else "the" }} safety gate</span><span role="cell" class="q warn"><b>{{ quadrants.unsafe_success }}</b></span><span role="cell" class="q warn"><b>{{ quadrants.unsafe_failure }}</b></span></div>
{% if quadrants.crashed %}
<div role="row"><span role="rowheader">crashed</span><span role="cell" class="q warn both"><b>{{ quadrants.crashed }}</b>{% if crashed_over %} <br>{{ crashed_over }} after a force above the safety gate{% endif %}</span></div>
{% endif %}
</div>
<div class="scroll" tabindex="0" role="region" aria-label="Table of force limits">
<table>
<thead><tr><th scope="col">limit</th><th scope="col" class="num">trials above</th><th scope="col" class="num">of them successful</th><th scope="col" class="num">highest peak as a share of the limit</th></tr></thead>
<tbody>
{% for row in limit_rows %}
<tr class="has-why"><th scope="row">{{ row.name }}</th><td class="num">{{ row.count }}{% if enough and not row.unknown %}<span class="meaning">{{ "%.0f"|format(100 * row.above.low) }} to {{ "%.0f"|format(100 * row.above.high) }} %</span>{% endif %}</td><td class="num">{{ row.n_success }}</td><td class="num">{{ rounded(row.worst) }}</td></tr>
<tr class="why"><td colspan="4">{{ row.note }}{% if row.worst_at %}; highest in {{ row.worst_at }}{% endif %}</td></tr>
{% endfor %}
</tbody>
</table>
{% if footnote %}
<p class="note after">{{ footnote }}.</p>
{% endif %}
</div>
</div>
</section>
"""


@section("safety", order=40, template=SAFETY_TEMPLATE)
def safety(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    rows = limit_rows(page.judged, gamma=page.gamma, unknown=len(page.unjudged))
    return {
        "n": len(page.judged) + len(page.unjudged),
        "trials": page.trials,
        "enough": enough_seeds(page.judged),
        "quadrants": quadrants(page.judged),
        "crashed_over": sum(score.is_crash and bool(score.over_limit) for score in page.judged),
        "untouched": sum(score.crashed_untouched for score in page.judged),
        "joints": joint_counts(page.judged),
        "limit_rows": rows,
        "footnote": footnote(row.name for row in rows),
        "rounded": rounded,
    }


# How hard and how long the person was touched, task by task.

LOAD_TEMPLATE = """\
<section id="load">
<h2>How hard, how long</h2>
<p class="note">Medians over the trials with valid contact; n is given where a median is over another number of trials. NA: no trial had a value; –: the metric says nothing about this action. "Time above" is the time in a trial during which the force or the pressure on any segment is above the level. A value relative to a limit is 1 at that limit. A row without a unit is a share or another plain number.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table of force, exposure and work by task">
<table>
<thead>
<tr><th scope="col">median of</th><th scope="col">unit</th>{% for task in load.tasks + ("all",) %}<th scope="col" class="num">{{ task }}<span class="meaning">n = {{ load.contacts[loop.index0] }}</span></th>{% endfor %}</tr>
</thead>
<tbody>
<tr><th scope="row">Trials with valid contact{% if trials %}<span class="meaning">of the {{ trials }}</span>{% endif %}</th><td></td>{% for k in load.contacts %}<td class="num">{{ k }}{% if k != load.n[loop.index0] %} of {{ load.n[loop.index0] }}{% endif %}</td>{% endfor %}</tr>
{% for row in load.rows %}
<tr><th scope="row">{{ row.metric.title }}</th><td class="keep">{{ row.unit }}</td>{% for cell in row.cells(load.contacts) %}<td class="num">{{ cell|replace("-", "−") }}</td>{% endfor %}</tr>
{% endfor %}
{% for row in nursing %}
<tr><th scope="row">{{ row.title }}<span class="meaning">trials that pass, of those with a value</span></th><td></td>{% for task in load.tasks %}<td></td>{% endfor %}<td class="num">{{ row.yes }} of {{ row.n }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
{% if note %}
<p class="note after">{{ note }}.</p>
{% endif %}
</section>
"""


@section("load", order=50, template=LOAD_TEMPLATE)
def load_section(page: Page) -> dict[str, Any] | None:
    """The metrics that have no column in the table by task."""
    if only_crashes(page.judged):
        return None
    found = load(page.judged)
    if not found.rows:
        return None
    note = footnote(row.metric.title for row in found.rows)
    trials = page.trials if page.unjudged else ""
    return {"load": found, "trials": trials, "nursing": nursing_rows(page.judged, page.protocol), "note": note}
