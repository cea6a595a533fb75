"""What other policies pass on the same protocol: blind baselines, and the shipped methods."""

from __future__ import annotations

from typing import Any

from carecontact.reports.compare.blind_floor import ALL
from carecontact.reports.intervals import enough, enough_seeds
from carecontact.reports.page.section import Page, section
from carecontact.reports.short_names import short_names

TEMPLATE = """\
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


@section("baselines", order=70, template=TEMPLATE)
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
