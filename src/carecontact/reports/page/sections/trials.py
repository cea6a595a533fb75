"""The trials one by one: result, metrics, progress, and why a trial failed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from carecontact.contract.protocol import Protocol
from carecontact.regions import REGIONS
from carecontact.reports.evidence_words import evidence_text
from carecontact.reports.joint_words import beyond_text, consumed_text
from carecontact.reports.page.paths import shortened
from carecontact.reports.page.script import table_script
from carecontact.reports.page.section import Page, section
from carecontact.reports.page.trial_words import progress, result_word
from carecontact.reports.page_links import link_to_page
from carecontact.reports.table import headlines
from carecontact.reports.text import NOT_DEFINED, shown, task_name
from carecontact.scoring.metrics.metric import Metric
from carecontact.scoring.result import TrialScore

NEAR_LIMIT = 0.5
"""Share of a borrowed safety gate from which on the report names the segment."""
TEMPLATE = """\
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


@section("trials", order=90, template=TEMPLATE)
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
