"""Whether success and safety go together, and how many trials were above each force limit."""

from __future__ import annotations

from typing import Any

from carecontact.reports.failures import only_crashes
from carecontact.reports.intervals import enough_seeds
from carecontact.reports.joint_words import joint_counts
from carecontact.reports.limit_rows import limit_rows
from carecontact.reports.page.section import Page, section
from carecontact.reports.text import rounded
from carecontact.runs.aggregate import quadrants
from carecontact.scoring.limits import footnote

TEMPLATE = """\
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


@section("safety", order=40, template=TEMPLATE)
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
