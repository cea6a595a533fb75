"""The first sections of a run's page: one sentence that may be quoted, the scene, the baselines beside the run, and the
tasks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from carecontact.recording.schema import Recording
from carecontact.report.baselines import ALL, Baselines, Passed, role_in
from carecontact.report.failures import only_crashes
from carecontact.report.links import replay_commands
from carecontact.report.paired import Over
from carecontact.report.run_page import Kept, Page, protocol_of, same_trials, section
from carecontact.report.svg import Frame, jpeg_data_uri
from carecontact.report.tables import COUNTS, POOLED, SummaryRow, headlines, summary_rows
from carecontact.report.words import NOT_DEFINED, enough, enough_seeds, short_names, shown
from carecontact.runs.pooling import judged
from carecontact.runs.results_file import valid_ratio
from carecontact.scoring.metrics.metric import METRICS, Metric
from carecontact.scoring.result import TrialScore
from carecontact.stats import RateDifference

# The head of the page: one sentence that somebody who reads nothing else may quote, and the scene.

REPLAY = "replay"
"""The shipped baseline that repeats recorded actions blindly."""
HEAD_TEMPLATE = """\
<header id="verdict">
<p class="eyebrow">carecontact report{% if policy %} · {{ policy }}{% endif %}{% if protocol %} · {{ protocol }}{% endif %} · {{ trials }}{% if draft %} <span class="draft">draft protocol</span>{% endif %}</p>
<div class="lead{{ '' if scene else ' alone' }}">
<div>
<h1>{{ verdict }}</h1>
{% if beside %}
<p class="beside">{{ beside }}</p>
{% endif %}
{% if commands %}
<pre>{{ commands|join("\n") }}</pre>
{% endif %}
</div>
{% if scene %}
<figure><img src="{{ scene.uri }}" alt="Simulated scene, {{ scene.text }}"><figcaption>{{ scene.name }}: {{ scene.text }}</figcaption></figure>
{% endif %}
</div>
</header>
"""


def keep_scene(score: TrialScore, recording: Recording, kept: Kept) -> None:
    """The first scene that a trial stored."""
    if "scene" not in kept and "report/snapshot_rgb" in recording.arrays:
        uri = jpeg_data_uri(recording["report/snapshot_rgb"])
        kept["scene"] = Frame(name="The scene", text=f"snapshot of {score.task_id}, seed {score.seed}", uri=uri)


@section("head", order=0, template=HEAD_TEMPLATE, keep=keep_scene)
def head(page: Page) -> dict[str, Any]:
    return {
        "policy": page.scores[0].policy_title if page.scores else None,
        "protocol": protocol_of(page),
        "trials": page.trials,
        "draft": any(not header.spec.protocol.frozen for header in page.headers.values()),
        "scene": page.kept["head"].get("scene"),
        "verdict": verdict(page.scores, unknown=len(page.unjudged)),
        "beside": _beside(page),
        "commands": _commands(page),
    }


def _beside(page: Page) -> str:
    """Whether the policy is better than one that does not look; for a policy that is no method, what it is for."""
    role = role_in(page.judged)
    if role == "blind":
        return (
            f"{page.judged[0].policy_title[:80]} is a blind baseline, which lacks what the tasks require: each trial "
            "that it passes is a false positive of the gates."
        )
    if role == "privileged":
        return ""
    return beside_blind(page.baselines) or _nothing_beside(page)


def _nothing_beside(page: Page) -> str:
    """Return what the reader can do where no blind policy stands beside the run; ``_commands`` say how."""
    if not page.judged or not page.kept_scores:
        return page.kept_scores
    return (
        f"{page.kept_scores} These commands tell whether {page.judged[0].policy_title[:80]} is better than actions "
        "repeated blindly; give them in the folder in which the command that wrote this page was given:"
    )


def _commands(page: Page) -> tuple[str, ...]:
    told = page.kept_scores and role_in(page.judged) not in ("blind", "privileged") and not beside_blind(page.baselines)
    return replay_commands(page.judged, page.folder) if page.judged and told else ()


def beside_blind(baselines: Baselines | None) -> str:
    """Return whether the policy is better than the best baseline of the floor; empty without any. To be better than
    another blind baseline, replay for example, does not show that a policy looks."""
    if baselines is None:
        return ""
    best = baselines.floor[ALL].policy if ALL in baselines.floor else ""
    best_is_blind = ALL in baselines.floor and baselines.floor[ALL].blind
    rows = {row.policy: row for row in baselines.baselines}
    blind = rows.get(best, rows.get(REPLAY))
    if blind is None or blind.above is None:
        return ""
    method, difference = baselines.method.policy, blind.above["safety_gated"]
    kind = "the best blind baseline" if best_is_blind else "the best baseline"
    name = "blind replay" if blind.policy == REPLAY else short_names([blind.policy])[blind.policy]
    who = "blind replay, which looks at nothing," if blind.policy == REPLAY else f"{kind}, {name},"
    said = f"{_rates(baselines.method, blind, who)} {_which(method, name, blind, difference, baselines.over)}"
    if blind.whole is None:
        return said
    return f"{said} {name[0].upper()}{name[1:]} passed {blind.whole.k} of all {blind.whole.n} trials of these tasks that it has."


def _rates(method: Passed, blind: Passed, who: str) -> str:
    """Return how much each passed of the trials that both have, or of its own trials where there is no such trial."""
    passed = blind.rates["safety_gated"].k
    if not blind.n_pairs:
        own = method.rates["safety_gated"]
        return (
            f"{who[0].upper()}{who[1:]} passed {passed} of {blind.n} other trials; {method.policy} {own.k} of {own.n}."
        )
    trials = "the only trial" if blind.n_pairs == 1 else f"the {blind.n_pairs} trials"
    return f"On {trials} that both have, {method.policy} passed {blind.method_passed} and {who} {passed}."


def _which(method: str, name: str, blind: Passed, difference: RateDifference, over: Over) -> str:
    """Whether the difference shows that one of them is better."""
    if not enough(blind.above_seeds or 0) or difference.estimate is None:
        return "With fewer than six seeds, this does not show which is better."
    low, high = (f"{100 * bound:.0f}".replace("-", "−") for bound in (difference.low, difference.high))
    points = f"{100 * difference.estimate:.0f} points, 95 % interval {low} to {high}".replace(
        "-", "−"
    ) + " over seeds" * (over == "seeds")
    if difference.low > 0:
        return f"The difference, {points}, shows that {method} is better."
    if difference.high < 0:
        return f"The difference, {points}, shows that {name} is better."
    return f"The difference, {points}, does not show which is better."


def verdict(scores: Sequence[TrialScore], *, unknown: int = 0) -> str:
    """Return the sentence on all trials of a run. ``unknown``: planned trials without a verdict."""
    counted = judged(scores)
    if not unknown or not counted:
        return _verdict(scores)
    n, gated = len(counted), sum(score.safety_gated for score in counted)
    return (
        f"Incomplete, {n} of {n + unknown} trials have a verdict: {counted[0].policy_title[:80]} passes between {gated} "
        f"and {gated + unknown} of {n + unknown} on the named region and below the safety gate."
    )


def _verdict(scores: Sequence[TrialScore]) -> str:
    counted = judged(scores)
    n = len(counted)
    if scores and not counted:
        failed_in = _every(len(scores))
        return f"The harness failed in {failed_in}, so there is nothing to say about the policy."
    if not counted:
        return "No trial of this run could be scored, so there is nothing to say about the policy."
    success, correct, gated = (
        sum(getattr(s, field) for s in counted) for field in ("c3_success", "region_correct", "safety_gated")
    )
    policy = counted[0].policy_title[:80]
    gates = "on the named region and below the safety gate"
    crashed = sum(s.is_crash for s in counted)
    if crashed == n:
        return f"{policy} crashed in {_every(n)}{_before_crash(counted)}."
    also = (
        f"; it crashed in {crashed}{_before_crash([s for s in counted if s.is_crash], quiet=True)}" if crashed else ""
    )
    if not success:
        what = "did not pass its only trial" if n == 1 else f"passed none of {n} trials"
        return f"{policy} {what}; it touched the person in {sum(s.valid_contact for s in counted)} of {n}{also}."
    if gated == n:
        return f"{policy} passed {_every(n)} {gates}."
    lost = [f"{success - correct} had too much contact outside the named region"] * (success > correct)
    lost += [f"{correct - gated} exceeded the safety gate"] * (correct > gated)
    tail = f"; of its {success} success{'es' * (success > 1)}, {' and '.join(lost)}" if lost else ""
    return f"{policy} passed {gated or 'none'} of {n} {'trial' if n == 1 else 'trials'} {gates}{tail}{also}."


def _every(n: int) -> str:
    return {1: "its only trial", 2: "both trials"}.get(n, f"all {n} trials")


def _before_crash(crashed: Sequence[TrialScore], *, quiet: bool = False) -> str:
    """Return what these trials did to the person before they crashed. ``quiet``: say nothing of a force below the
    gate."""
    over = sum(bool(s.over_limit) for s in crashed)
    touched = sum(not s.crashed_untouched for s in crashed)
    k, what = (over, "a force above the safety gate") if over else (touched, "it touched the person")
    if not k:
        return "" if quiet else "; nothing else can be said about it"
    if quiet and not over:
        return ""
    return f", after {what}" if len(crashed) == 1 else f", in {k} of them after {what}"


# What other policies pass on the same protocol: blind baselines, and the shipped methods.

BASELINES_TEMPLATE = """\
<section id="baselines">
<h2>{{ "Shipped policies and blind baselines" if shipped else "Blind baselines" if only_blind else "Baselines" }}</h2>
<p class="note">A blind baseline is a policy that deliberately lacks an ability that the task is meant to require. Each of its successes is a false positive of the gates. Therefore, a method has shown only the difference between its rate and those of the baselines. The last column has the safety-gated rate of this run minus that of each policy. {% if enough %}{% if over_seeds %}The 95 % intervals of rates, and of differences of safety-gated rates, are over seeds, from resampled seeds: a seed is one person, whose trials are not independent.{% else %}Rates have Wilson 95 % intervals; differences of safety-gated rates have Newcombe 95 % intervals, over pairs of the same task and seed if both runs have them. Both take trials as independent.{% endif %}{% else %}There are no intervals, because the run has fewer than six seeds.{% endif %}{% if fewer %} Where another policy has more trials than this run, its rates are over the trials that both have; “in all” is its rate over all of its trials of these tasks.{% endif %}{% if shipped %} From the scores that are kept of the shipped policies: {{ shipped }}.{% endif %}{% if completed %} You named runs of {{ completed }}; trials that they lack come from the kept scores.{% endif %}{% if machines %} {{ machines }}.{% endif %}</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table of other policies">
<table>
<thead><tr><th scope="col">policy</th><th scope="col" class="num">trials</th><th scope="col" class="num">success</th><th scope="col" class="num">region-correct</th><th scope="col" class="num">safety-gated</th><th scope="col" class="num wrap">safety-gated: this run − policy [points]</th></tr></thead>
<tbody>
{% for row in rows %}
<tr{% if loop.first %} class="sum method"{% endif %}><th scope="row" class="keep">{{ names[row.policy] }}{% if names[row.policy] != row.policy %}<span class="meaning whole">{{ row.policy }}</span>{% endif %}{% if row.role == "privileged" %}<span class="meaning">ceiling: it is given the simulation</span>{% elif row.role == "probe" %}<span class="meaning">probe</span>{% elif row.policy == best %}<span class="meaning">{{ best_name }}</span>{% endif %}</th><td class="num">{{ row.trials }}</td>{% for name, rate in row.rates.items() %}<td class="num">{{ row.count(name) }}{% if enough and not row.unknown and enough_of(row.seeds) %}<span class="meaning">{{ "%.0f"|format(100 * rate.low) }} to {{ "%.0f"|format(100 * rate.high) }} %</span>{% endif %}{% if row.whole and name == "safety_gated" %}<span class="meaning">in all {{ row.whole.k }} of {{ row.whole.n }}</span>{% endif %}</td>{% endfor %}<td class="num">{% if row.above %}{% set d = row.above.safety_gated %}{{ ("%.0f"|format(100 * d.estimate))|replace("-", "−") }}<span class="meaning">{% if enough_of(row.above_seeds) %}{{ ("%.0f"|format(100 * d.low))|replace("-", "−") }} to {{ ("%.0f"|format(100 * d.high))|replace("-", "−") }}, {% endif %}{% if row.n_pairs %}{{ row.n_pairs }} pair{{ "" if row.n_pairs == 1 else "s" }}{% else %}unpaired{% endif %}</span>{% endif %}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
<h3 class="after">Successes by task{% if rows[0].unknown %}, of the trials with a verdict{% endif %}</h3>
<div class="scroll" tabindex="0" role="region" aria-label="Table of successes of other policies by task">
<table class="baselines">
<thead><tr><th scope="col">policy</th>{% for task in tasks %}<th scope="col" class="num">{{ task }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in rows %}
{% set blind = row.role == "blind" %}
<tr{% if loop.first %} class="sum method"{% endif %}><th scope="row" class="keep">{{ names[row.policy] }}</th>{% for task in tasks %}{% set of_task = row.per_task.get(task) %}<td class="num{% if blind and of_task and of_task.success[0] %} false{% endif %}">{% if of_task and of_task.success[1] %}{{ of_task.success[0] }}/{{ of_task.success[1] }}{% else %}–{% endif %}</td>{% endfor %}</tr>
{% endfor %}
{% if floor %}
<tr class="sum"><th scope="row" class="keep">{{ best_name }}<span class="meaning">safety-gated</span></th>{% for task in tasks %}{% set at = floor.get(task) %}<td class="num">{% if at %}{{ at.rate.k }}/{{ at.rate.n }}<span class="meaning">{{ names[at.policy] }}</span>{% else %}–{% endif %}</td>{% endfor %}</tr>
{% endif %}
</tbody>
</table>
</div>
</section>
"""


@section("baselines", order=70, template=BASELINES_TEMPLATE)
def baselines(page: Page) -> dict[str, Any] | None:
    found = page.baselines
    if not page.judged or found is None:
        return None
    best = found.floor.get(ALL)
    return {
        "rows": [found.method, *found.baselines],
        "tasks": found.tasks,
        "floor": found.floor,
        "best": None if best is None else best.policy,
        "best_name": "best blind baseline" if all(at.blind for at in found.floor.values()) else "best baseline",
        "only_blind": found.only_blind,
        "over_seeds": found.over == "seeds",
        "names": short_names([found.method.policy, *(row.policy for row in found.baselines)]),
        "enough": enough_seeds(page.judged),
        "fewer": any(row.whole is not None for row in found.baselines),
        "enough_of": enough,
        "completed": " and ".join(found.completed),
        "shipped": ", ".join(found.kept),
        "machines": found.machines,
    }


# Counts and medians, task by task.

BY_TASK_TEMPLATE = """\
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


@section("by task", order=30, template=BY_TASK_TEMPLATE)
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
    found += [(row.share(k), _beside_task(page, row.task_id, rate)) for rate, k in counts.items()]
    if medians:
        for metric_id, median in row.medians.items():
            metric = METRICS[metric_id]
            defined = metric.actions is None or median.n
            text = shown(median.estimate, digits=metric.digits, unit=metric.unit) if defined else NOT_DEFINED
            found.append((text, [] if median.estimate is None else [(f"n = {median.n_valid}", "")]))
    return found


def _names(page: Page) -> dict[str, str]:
    return short_names([row.policy for row in page.baselines.baselines] if page.baselines else [])


def _beside_task(page: Page, task_id: str, rate: str) -> list[tuple[str, str]]:
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
