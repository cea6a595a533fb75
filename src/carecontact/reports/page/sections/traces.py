"""Force over time, one panel a trial."""

from __future__ import annotations

from typing import Any

from carecontact.recording.schema import Recording
from carecontact.reports.failures import only_crashes
from carecontact.reports.page.chosen import FAILURES_SHOWN
from carecontact.reports.page.force_trace import ForceTrace, force_trace, trace_svg
from carecontact.reports.page.section import Kept, Page, section
from carecontact.reports.page.trial_words import result_word
from carecontact.reports.text import task_name
from carecontact.scoring.result import TrialScore

TEMPLATE = """\
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


@section("traces", order=100, template=TEMPLATE, keep=keep_trace)
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
