"""Counts and medians, task by task."""

from __future__ import annotations

from typing import Any

from carecontact.reports.page.section import Page, section
from carecontact.reports.table import POOLED, columns, headlines, summary_rows
from carecontact.runs.aggregate import valid_ratio
from carecontact.scoring.metrics.metric import Metric

TEMPLATE = """\
<section>
<h2>By task</h2>
<p class="note">Counts, then medians over trials with a valid value; n is given where fewer were valid, NA where none was. {{ metrics }}. {{ valid.n }} of {{ n }} trials have a trajectory to score (valid ratio {{ '%.0f'|format(valid.pc) }} %, 95 % interval {{ '%.0f'|format(valid.pc_ci95[0]) }} to {{ '%.0f'|format(valid.pc_ci95[1]) }} %); {{ touched }} had valid contact.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table by task">
<table>
<thead><tr>{% for column in columns %}<th scope="col"{% if loop.index > 2 %} class="num{% if column == "n" %} wide{% endif %}"{% endif %}>{{ column }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in rows %}
<tr{% if row.task_id == pooled %} class="sum"{% endif %}>{% for cell in row.cells() %}{% if loop.first %}<th scope="row">{{ cell }}</th>{% elif loop.index > 2 %}<td class="num{% if loop.index == 3 %} wide{% endif %}">{{ cell|replace("-", "−") }}</td>{% else %}<td class="taskname">{{ cell }}</td>{% endif %}{% endfor %}</tr>
{% endfor %}
</tbody>
</table>
</div>
</section>
"""


@section("by task", order=30, template=TEMPLATE)
def by_task(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    return {
        "columns": columns(),
        "rows": summary_rows(page.scores),
        "pooled": POOLED,
        "metrics": ", ".join(map(_explained, headlines())),
        "valid": valid_ratio(page.judged),
        "n": len(page.judged),
        "touched": sum(score.valid_contact for score in page.judged),
    }


def _explained(metric: Metric) -> str:
    pooled = f" (pooled over {' and '.join(metric.actions)} only)" if metric.actions is not None else ""
    return f"{metric.name} {metric.title[0].lower()}{metric.title[1:]}{pooled}"
