"""Counts and medians, task by task."""

from __future__ import annotations

from typing import Any

from carecontact.reports.failures import only_crashes
from carecontact.reports.page.section import Page, section
from carecontact.reports.table import COUNTS, POOLED, columns, headlines, summary_rows
from carecontact.runs.aggregate import valid_ratio
from carecontact.scoring.metrics.metric import Metric

AFTER_N = COUNTS.index("n") + 1
"""Place of the column for crashes."""
TEMPLATE = """\
<section>
<h2>By task</h2>
<p class="note">{% if only_crashes %}The policy crashed in every trial before any contact. Therefore, this page has no medians, and nothing on force, safety, load and gates.{% else %}Counts, then medians over trials with a valid value; n is given where fewer were valid, NA where none was. {{ metrics }}. {{ valid.n }} of {{ n }} trials have a trajectory to score (valid ratio {{ '%.0f'|format(valid.pc) }} %, 95 % interval {{ '%.0f'|format(valid.pc_ci95[0]) }} to {{ '%.0f'|format(valid.pc_ci95[1]) }} %); {{ touched }} had valid contact.{% endif %}</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table by task">
<table>
<thead><tr>{% for column in columns %}<th scope="col"{% if loop.index > 2 %} class="num{% if column == "n" %} wide{% endif %}"{% endif %}>{{ column }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in rows %}
<tr{% if row[0] == pooled %} class="sum"{% endif %}>{% for cell in row %}{% if loop.first %}<th scope="row">{{ cell }}</th>{% elif loop.index > 2 %}<td class="num{% if loop.index == 3 %} wide{% endif %}">{{ cell|replace("-", "−") }}</td>{% else %}<td class="taskname">{{ cell }}</td>{% endif %}{% endfor %}</tr>
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
    nothing = only_crashes(page.judged)
    heads, rows = list(columns()), [row.cells() for row in summary_rows(page.scores)]
    if nothing:
        heads, *rows = (cells[: len(COUNTS)] for cells in (heads, *rows))
    if any(score.is_crash for score in page.judged):
        heads.insert(AFTER_N, "crashed")
        for cells in rows:
            of_row = [score for score in page.judged if cells[0] in (score.task_id, POOLED)]
            cells.insert(AFTER_N, f"{sum(score.is_crash for score in of_row)}/{len(of_row)}")
    return {
        "columns": heads,
        "only_crashes": nothing,
        "rows": rows,
        "pooled": POOLED,
        "metrics": ", ".join(map(_explained, headlines())),
        "valid": valid_ratio(page.judged),
        "n": len(page.judged),
        "touched": sum(score.valid_contact for score in page.judged),
    }


def _explained(metric: Metric) -> str:
    pooled = f" (pooled over {' and '.join(metric.actions)} only)" if metric.actions is not None else ""
    return f"{metric.name} {metric.title[0].lower()}{metric.title[1:]}{pooled}"
