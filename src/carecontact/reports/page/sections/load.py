"""How hard and how long the person was touched, task by task."""

from __future__ import annotations

from typing import Any

from carecontact.reports.failures import only_crashes
from carecontact.reports.load import load
from carecontact.reports.nursing import nursing_rows
from carecontact.reports.page.section import Page, section
from carecontact.scoring.limits import footnote

TEMPLATE = """\
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


@section("load", order=50, template=TEMPLATE)
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
