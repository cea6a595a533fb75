"""Sections that show trials one by one: their table, force traces, and the moment of peak force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from carecontact.interface.regions import REGIONS
from carecontact.protocol.protocol import Protocol
from carecontact.recording.schema import Recording
from carecontact.report.failures import evidence_text, only_crashes, progress, result_word
from carecontact.report.force_trace import ForceTrace, force_trace, trace_svg
from carecontact.report.links import link_to_page, shortened
from carecontact.report.miss import drawn_svg, is_hidden, miss_svg, nearest_miss
from carecontact.report.moment import peak_moment, peak_svg
from carecontact.report.run_page import FAILURES_SHOWN, Kept, Page, section, table_script
from carecontact.report.tables import headlines
from carecontact.report.words import NOT_DEFINED, beyond_text, consumed_text, shown, task_name
from carecontact.scoring.contact import faint_press, find_contact
from carecontact.scoring.metrics.metric import Metric
from carecontact.scoring.result import TrialScore

# The trials one by one: result, metrics, progress, and why a trial failed.

NEAR_LIMIT = 0.5
"""Share of a borrowed safety gate from which on the report names the segment."""
TRIALS_TEMPLATE = """\
<section id="trials">
<h2>Trial by trial</h2>
<p class="note">{% if n == 1 %}The only trial.{% else %}{% if unknown %}{{ trials }}{% else %}All {{ trials }}{% endif %}.{% endif %} "Gate" is the safety gate of the named region. Every other touched segment has to stay below its own safety gate, or below the strictest one if it has none; the table names a segment without its own if its peak was at least half of the strictest one.{% if not pages %} For the page of a trial, run <span class="keep">carecontact report TRIAL.h5</span>, or <span class="keep">carecontact report DIR --trials</span> for all of them.{% endif %}</p>
<form class="filter" id="filter" hidden>
<label>Task <select id="filter-task"><option value="">all</option>{% for task in tasks %}<option>{{ task }}</option>{% endfor %}</select></label>
<label>Result <select id="filter-result"><option value="">all</option>{% for result in results %}<option>{{ result }}</option>{% endfor %}</select></label>
<label>Words <input id="filter-words" type="search" autocomplete="off"></label>
<output id="filter-count"></output>
</form>
<div class="scroll" tabindex="0" role="region" aria-label="Table of trials">
<table id="trial-table">
<thead><tr><th scope="col">trial</th><th scope="col" class="num">seed</th><th scope="col">result</th><th scope="col" class="num">gate [N]</th>{% for label in labels %}<th scope="col" class="num">{{ label }}</th>{% endfor %}<th scope="col" class="wide">progress</th></tr></thead>
{% for d in details %}
{% set why = d.failure or d.evidence or d.notes %}
<tbody id="{{ d.trial_id }}" data-task="{{ d.task_id }}" data-result="{{ d.result_text }}">
<tr class="{{ 'has-why' if why else 'has-progress' }}"><th scope="row" class="keep" data-v="{{ d.trial_id }}">{{ d.link|safe }}{{ d.trial_id }}</a><span class="wide"> {{ d.name }}</span></th><td class="num" data-v="{{ d.seed }}">{{ d.seed }}</td><td><span class="badge {{ d.result }}">{{ d.result_text }}</span></td><td class="num" data-v="{{ d.gate }}">{{ d.gate }}</td>{% for cell in d.cells %}<td class="num" data-v="{{ cell }}">{{ cell|replace("-", "−") }}</td>{% endfor %}<td class="wide">{{ d.progress }}{% if d.files and not why %} <span class="files">{% for words, address in d.files %}<a href="{{ address }}">{{ words }}</a>{% if not loop.last %} · {% endif %}{% endfor %}</span>{% endif %}</td></tr>
<tr class="why{{ '' if why else ' narrow' }}"><td colspan="{{ labels|length + 5 }}"><span class="narrow">{{ d.progress }}{% if why %}<br>{% endif %}</span>{% if d.failure %}<b>{{ d.failure }}</b>{% endif %}{% if d.failure and d.evidence %}: {% endif %}{{ d.evidence }}{% for name, text in d.notes %}{% if not loop.first or d.failure or d.evidence %}<br>{% endif %}<b>{{ name }}</b>: {{ text }}{% endfor %}{% if d.files %} <span class="files">{% for words, address in d.files %}<a href="{{ address }}">{{ words }}</a>{% if not loop.last %} · {% endif %}{% endfor %}</span>{% endif %}</td></tr>
</tbody>
{% endfor %}
</table>
</div>
<script>{{ script|safe }}</script>
</section>
"""


@dataclass(frozen=True, kw_only=True)
class TrialRow:
    trial_id: str
    task_id: str
    name: str
    seed: int
    result: str
    """pass, hard, region, fail or crash: the style; the words are in ``result_text``."""
    result_text: str
    gate: str
    """Force limit of the named region [N]."""
    cells: tuple[str, ...]
    """One for each headline metric."""
    progress: str
    notes: tuple[tuple[str, str], ...]
    """Name and text of what is told beside the failure: segments over their gate, segments at NEAR_LIMIT of a gate
    that is not their own, joints beyond their range, and joints that are flagged."""
    failure: str
    """Mode and attribution; empty if none."""
    evidence: str
    has_page: bool
    """Whether the page of the trial is there."""
    link: str
    """Beginning of the link to that page."""
    files: tuple[tuple[str, str], ...]
    """Words and address of the other files of the trial."""


@section("trials", order=90, template=TRIALS_TEMPLATE)
def trials(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    rows = [trial_row(score, page.protocol, links=page.links) for score in page.judged]
    return {
        "n": len(page.judged),
        "trials": page.trials,
        "unknown": len(page.unjudged),
        "details": rows,
        "labels": [metric.label for metric in headlines()],
        "tasks": sorted({row.task_id for row in rows}),
        "results": sorted({row.result_text for row in rows}),
        "pages": any(row.has_page for row in rows),
        "script": table_script(),
    }


def trial_row(score: TrialScore, protocol: Protocol | None, *, links: Mapping[str, str] | None = None) -> TrialRow:
    """
    Args:
        protocol: of the run; None where no recording could be read.
        links: file in the run's folder -> its address.
    """
    result, text = result_word(score)
    ratios, gate = dict(score.over_limit), NOT_DEFINED
    if protocol is not None:
        limits = Limits.of(protocol, score)
        gate = f"{limits.gate_n:g}"
        for segment, ratio in limits.borrowed.items():
            ratios.setdefault(segment, ratio)
    borrowed = {s: ratios[s] for s in score.fallback_limits if ratios.get(s, 0.0) >= NEAR_LIMIT}
    notes = (
        ("over the safety gate", _ratios(score, score.over_limit, "its safety gate")),
        ("no limit of its own", _ratios(score, borrowed, "the strictest safety gate")),
        ("joint beyond its range", beyond_text(score)),
        ("joint flagged, share of its settled margin used up", consumed_text(score)),
    )
    addresses = links or {}
    files = (
        ("video", f"trial/{score.trial_id}.mp4"),
        ("recording", f"{score.trial_id}.h5"),
        ("log", f"{score.trial_id}.log"),
    )
    return TrialRow(
        trial_id=score.trial_id,
        task_id=score.task_id,
        name=task_name(score),
        seed=score.seed,
        result=result,
        result_text=text,
        gate=gate,
        cells=tuple(_cell(metric, score) for metric in headlines()),
        progress=progress(score),
        notes=tuple((name, text) for name, text in notes if text),
        failure=" · ".join(word for word in ((score.failure_mode or "").replace("_", " "), score.attribution) if word),
        evidence=shortened(evidence_text(score) or score.failure_message or ""),
        has_page=(has_page := f"trial/{score.trial_id}.html" in addresses),
        link=link_to_page(score.trial_id, is_there=has_page),
        files=tuple((words, addresses[name]) for words, name in files if name in addresses),
    )


@dataclass(frozen=True, kw_only=True)
class Limits:
    gate_n: float
    """gamma' F_pain of the named region's segment."""
    borrowed: dict[str, float]
    """Touched segment without a limit of its own -> its peak over the safety gate that holds for it."""

    @classmethod
    def of(cls, protocol: Protocol, score: TrialScore) -> Limits:
        gamma, segment = protocol.limits.gamma, REGIONS[score.region].segment
        return cls(
            gate_n=gamma * protocol.f_pain(segment),
            borrowed={s: score.peak_force_n[s] / (gamma * protocol.f_pain(s)) for s in score.fallback_limits},
        )


def _cell(metric: Metric, score: TrialScore) -> str:
    if metric.actions is not None and score.action not in metric.actions:
        return NOT_DEFINED
    return shown(metric.of(score), digits=metric.digits, unit=metric.unit)


def _ratios(score: TrialScore, ratio_of: Mapping[str, float], gate: str) -> str:
    return ", ".join(
        f"{segment.replace('_', ' ')} {score.peak_force_n.get(segment, float('nan')):.1f} N = {ratio:.2f} × {gate}"
        for segment, ratio in sorted(ratio_of.items())
    )


# Force over time, one panel a trial.

TRACES_TEMPLATE = """\
<section id="force">
<h2>Force over time</h2>
<p class="note">{% if traces %}Norm of the robot's force on a body segment, in newtons, against the limits of that segment. The vertical scale differs between panels; a limit appears, with the name of its segment, once the force on that segment reaches a quarter of it.{% endif %}{% if not all_shown %} {{ n_shown }} of {{ n }} trials: the first of each task, and up to {{ failures_shown }} that did not pass, taken from all tasks in turn.{% endif %}</p>
{% if traces %}
<ul class="legend">
<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="target" d="M0 6h26"/></svg>segment of the named region</li>
<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="other" d="M0 6h26"/></svg>largest on any other segment</li>
<li><svg viewBox="0 0 26 12" aria-hidden="true"><rect class="window" width="26" height="12"/></svg>contact window</li>
<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="gate" d="M0 6h26"/></svg>gate, γ′ F<sub>pain</sub></li>
<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="pain" d="M0 6h26"/></svg>F<sub>pain</sub></li>
<li><svg viewBox="0 0 26 12" aria-hidden="true"><circle class="peak" cx="13" cy="6" r="3"/></svg>peak (C1)</li>
</ul>
<div class="traces">
{% for d in traces %}
<figure id="force-{{ d.trial_id }}"><div class="trace-head"><h3><a href="#{{ d.trial_id }}">{{ d.task_id }} {{ d.name }}</a> <span>seed {{ d.seed }}</span></h3><span class="badge {{ d.result }}">{{ d.result_text }}</span></div>
{{ d.svg|safe }}</figure>
{% endfor %}
</div>
{% endif %}
{% if untouched %}
<p class="note after">The robot pressed nothing, so that there is no force to draw: {% for trial_id, name in untouched %}<a href="#{{ trial_id }}">{{ name }}</a>{{ "; " if not loop.last else "." }}{% endfor %}</p>
{% endif %}
{% if without_trace %}
<p class="note after">No physics step was recorded, or none could be read: {{ without_trace|join("; ") }}.</p>
{% endif %}
</section>
"""


UNTOUCHED = ""
"""Stands for the panel of a trial in which the robot pressed nothing."""


def keep_trace(score: TrialScore, recording: Recording, kept: Kept) -> None:
    trace = force_trace(recording, score)
    if trace.is_touched:
        kept[score.trial_id] = trace_svg(trace, title=_alt_text(score, trace))
    elif trace.time_s.size:
        kept[score.trial_id] = UNTOUCHED


@section("traces", order=100, template=TRACES_TEMPLATE, keep=keep_trace)
def traces(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    drawn = {trial_id: svg for trial_id, svg in page.kept["traces"].items() if trial_id in page.headers}
    rows = [_panel(score, svg) for score in page.shown if (svg := drawn.get(score.trial_id))]
    untouched = [s for s in page.shown if drawn.get(s.trial_id) == UNTOUCHED]
    return {
        "traces": rows,
        "untouched": [(s.trial_id, f"{s.task_id} {task_name(s)}, seed {s.seed}") for s in untouched],
        "without_trace": [f"{s.task_id} {task_name(s)}, seed {s.seed}" for s in page.shown if s.trial_id not in drawn], "n": len(page.judged), "n_shown": len(page.shown), "failures_shown": FAILURES_SHOWN,
        "all_shown": len(page.shown) == len(page.judged),
    }  # fmt: skip


def _panel(score: TrialScore, svg: str) -> dict[str, Any]:
    result, text = result_word(score)
    return {
        "trial_id": score.trial_id, "task_id": score.task_id, "name": task_name(score), "seed": score.seed, "result": result, "result_text": text,
        "svg": svg,
    }  # fmt: skip


def _alt_text(score: TrialScore, trace: ForceTrace) -> str:
    peak = "no valid contact" if score.c1_peak_force_n is None else f"peak {score.c1_peak_force_n:.1f} N"
    name = f"{score.task_id} {task_name(score)}, seed {score.seed}"
    return f"Force over time, {name}: {peak}, gate {trace.limits[0].value_n:g} N on the {trace.limits[0].segment}, {result_word(score)[1]}"


# The contact at the peak of the hardest trial of each task, with force, indentation and region drawn in.

FRAMES_TEMPLATE = """\
<section id="peak">
<h2>At peak force</h2>
<p class="note">For each task, the trial with the highest peak force among the {{ n }} trial{{ "" if n == 1 else "s" }} whose recordings were read for this page.{% if drawn %} Arrow: the force on the person; a circle with a cross where it points away from you. Bracket: the indentation, to scale. Dashed: the named region.{% endif %}{% if without_hand %} Where the hand or the person hides the contact, the skin is drawn without the hand; half transparent, the tip of the tool.{% endif %}{% if missed %} Where nothing was touched, a drawing shows the place at which the tool came nearest: thick the tool, thin its path.{% endif %}</p>
<div class="frames">
{% for frame in frames %}
<figure id="peak-{{ frame.trial_id }}">{{ frame.svg|safe }}<figcaption><b><a href="#{{ frame.trial_id }}">{{ frame.name }}</a></b><br>{{ frame.text }}</figcaption></figure>
{% endfor %}
</div>
</section>
"""


@dataclass(frozen=True, kw_only=True)
class PeakFrame:
    trial_id: str
    name: str
    text: str
    svg: str


def keep_frame(score: TrialScore, recording: Recording, kept: Kept) -> None:
    if score.task_id not in kept and (frame := peak_frame(score, recording)) is not None:
        kept[score.task_id] = frame


@section("frames", order=110, template=FRAMES_TEMPLATE, keep=keep_frame)
def frames(page: Page) -> dict[str, Any] | None:
    kept = page.kept["frames"]
    if not kept or only_crashes(page.judged):
        return None
    found = [kept[task] for task in sorted(kept)]
    return {
        "frames": found,
        "n": len(page.headers),
        "drawn": any(DRAWN in frame.svg for frame in found),
        "without_hand": any(WITHOUT_HAND in frame.svg for frame in found),
        "missed": any(MISSED in frame.svg for frame in found),
    }


DRAWN = 'class="arrow'
"""Part of a picture that has a force drawn in."""
WITHOUT_HAND = 'class="skin moment drawn"'
"""Part of a drawing of a contact that the stored picture does not show."""
MISSED = 'class="skin miss"'
"""Part of a drawing of a miss."""


def peak_frame(score: TrialScore, recording: Recording) -> PeakFrame | None:
    """Return the picture stored at peak force; None if the trial stored none. Raises RecordingError for a damaged
    one."""
    if "report/peak_rgb" not in recording.arrays:
        return None
    moment = peak_moment(recording)
    when = "" if moment is None else f" at {moment.time_s:.2f}\N{NO-BREAK SPACE}s"
    if score.c1_peak_force_n is None:
        faint = faint_press(find_contact(recording))
        what, when = f"the robot {faint}" if faint else "nothing touched", ""
    else:
        what = f"{score.c1_peak_force_n:.1f} N on the {(score.reported_segment or '').replace('_', ' ')}"
    if moment is not None and moment.depth_m:
        when += f", {1000 * moment.depth_m:.1f} mm deep"
    miss = nearest_miss(recording) if moment is None else None
    if miss is not None:
        when = f"; the tip of the tool came to {1000 * miss.away_m:.0f} mm from the region"
    text, name = f"{what}{when}, seed {score.seed}", f"{score.task_id} {task_name(score)}"
    svg = None if miss is None else miss_svg(recording, miss, title=f"Where the tool came nearest, {name}: {text}")
    title = f"The contact at peak force, {name}: {text}"
    if moment is not None and is_hidden(recording, moment):
        svg = drawn_svg(recording, moment, title=title)
    svg = svg or peak_svg(recording, moment, title=title)
    return None if svg is None else PeakFrame(trial_id=score.trial_id, name=name, text=text, svg=svg)
