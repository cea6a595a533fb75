"""Counts and medians, task by task."""

from __future__ import annotations

from typing import Any

from carecontact.reports.failures import only_crashes
from carecontact.reports.intervals import enough_seeds
from carecontact.reports.page.same_trials import same_trials
from carecontact.reports.page.section import Page, section
from carecontact.reports.page.sections.head import REPLAY
from carecontact.reports.short_names import short_names
from carecontact.reports.table import COUNTS, POOLED, SummaryRow, headlines, summary_rows
from carecontact.reports.text import NOT_DEFINED, shown
from carecontact.runs.aggregate import valid_ratio
from carecontact.scoring.metrics.metric import METRICS, Metric

TEMPLATE = """\
<section id="tasks">
<h2>By task</h2>
<p class="note">{% if only_crashes %}The policy crashed in every trial before any contact. Therefore, this page has no medians, and nothing on force, safety, load and gates.{% else %}Counts, then medians over the trials that have a value; n says over how many, NA that none has. {{ metrics }}. {{ valid.n }} of {{ trials }} {{ "has" if valid.n == 1 else "have" }} a trajectory to score (valid ratio {{ '%.0f'|format(valid.pc) }} %{% if unknown %} of those with a verdict{% endif %}{% if enough %}, 95 % interval {{ '%.0f'|format(valid.pc_ci95[0]) }} to {{ '%.0f'|format(valid.pc_ci95[1]) }} %{% endif %}); {{ touched }} had valid contact.{% endif %}{% if beside %} Under each count: what other policies passed {{ same }}; {{ "a policy that is not named under a count" if beside == 1 else "policies that are not named under a count" }} passed nothing there{{ (", or has" if beside == 1 else ", or have") ~ " no trials there" if gaps else "" }}.{% endif %}</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table by task">
<table>
<thead><tr><th scope="col">task</th><th scope="col">name</th>{% for column in columns %}<th scope="col" class="num{% if column == "n" %} wide{% endif %}">{{ column }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in rows %}
<tr{% if row.task_id == pooled %} class="sum"{% endif %}><th scope="row">{{ row.task_id }}</th><td class="taskname">{{ row.name }}</td>{% for cell, notes in row.cells %}<td class="num{% if loop.first %} wide{% endif %}">{{ cell|replace("-", "−") }}{% for note, whole in notes %}<span class="meaning"{% if whole %} title="{{ whole }}"{% endif %}>{{ note }}</span>{% endfor %}</td>{% endfor %}</tr>
{% endfor %}
</tbody>
</table>
</div>
{% if whole_names %}
<p class="note after">Whole names: {% for short, whole in whole_names %}{{ whole if whole.startswith(short ~ " ") else short ~ ": " ~ whole }}{{ "; " if not loop.last else "." }}{% endfor %}</p>
{% endif %}
</section>
"""
Cell = tuple[str, list[tuple[str, str]]]
"""Text, and smaller lines under it, each with the whole name of its policy if the line has a shorter one."""


@section("by task", order=30, template=TEMPLATE)
def by_task(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    nothing, crashed = only_crashes(page.judged), any(score.is_crash for score in page.judged)
    rates = COUNTS[COUNTS.index("n") + 1 :]
    others = page.baselines.baselines if page.baselines else ()
    return {
        "columns": ["n", *["crashed"] * crashed, *rates, *([] if nothing else [m.label for m in headlines()])],
        "only_crashes": nothing,
        "rows": [
            {"task_id": row.task_id, "name": row.name, "cells": _cells(page, row, crashed=crashed, medians=not nothing)}
            for row in summary_rows(page.scores, page.unjudged)
        ],
        "pooled": POOLED,
        "metrics": ", ".join(map(_explained, headlines())),
        "valid": valid_ratio(page.judged),
        "enough": enough_seeds(page.judged),
        "trials": page.trials,
        "unknown": len(page.unjudged),
        "touched": sum(score.valid_contact for score in page.judged),
        "whole_names": [(short, whole) for whole, short in _names(page).items() if short != whole],
        "same": same_trials(others, len(page.judged)) if others else "",
        "gaps": any(not row.per_task[task]["success"][1] for row in others for task in row.per_task),
        "beside": len(others),
    }


def _cells(page: Page, row: SummaryRow, *, crashed: bool, medians: bool) -> list[Cell]:
    of_row = [score for score in page.judged if row.task_id in (score.task_id, POOLED)]
    found: list[Cell] = [(row.trials, [])]
    if crashed:
        found.append((f"{sum(score.is_crash for score in of_row)}/{len(of_row)}", []))
    counts = {"success": row.success, "region_correct": row.region_correct, "safety_gated": row.safety_gated}
    found += [(row.share(k), _beside(page, row.task_id, rate)) for rate, k in counts.items()]
    if medians:
        for metric_id, median in row.medians.items():
            metric = METRICS[metric_id]
            defined = metric.actions is None or median.n
            text = shown(median.estimate, digits=metric.digits, unit=metric.unit) if defined else NOT_DEFINED
            found.append((text, [] if median.estimate is None else [(f"n = {median.n_valid}", "")]))
    return found


def _names(page: Page) -> dict[str, str]:
    return short_names([row.policy for row in page.baselines.baselines] if page.baselines else [])


def _beside(page: Page, task_id: str, rate: str) -> list[tuple[str, str]]:
    """Return what the policies beside the run passed, those that passed something; blind replay always."""
    found: list[tuple[str, str]] = []
    names = _names(page)
    for other in page.baselines.baselines if page.baselines else ():
        if task_id not in (POOLED, *other.per_task):
            continue  # A task of which the harness failed in every trial has nothing to stand beside.
        k, n = (other.rates[rate].k, other.n) if task_id == POOLED else other.per_task[task_id][rate]
        name = names[other.policy]
        if not n and other.policy == REPLAY:
            found.append((f"{name}: no trials here", ""))
        elif k or other.policy == REPLAY:
            found.append((f"{name} {k}/{n}", "" if name == other.policy else other.policy))
    return found


def _explained(metric: Metric) -> str:
    pooled = f" (pooled over {' and '.join(metric.actions)} only)" if metric.actions is not None else ""
    return f"{metric.name} {metric.title[0].lower()}{metric.title[1:]}{pooled}"
