"""Why trials failed: modes, causes with their evidence, and where contact fell."""

from __future__ import annotations

from typing import Any

from carecontact.reports.failures import anatomy, causes, failure_modes, only_crashes
from carecontact.reports.page.paths import shortened
from carecontact.reports.page.section import Page, section
from carecontact.reports.table import POOLED

TEMPLATE = """\
<section id="failures">
<h2>Why trials failed</h2>
{% if modes %}
<p class="note">{{ failed }} of {{ trials }} did not succeed on the named region{% if joints %}, or succeeded and moved a joint too far beyond its range{% endif %}. Each has exactly one failure mode and one cause (attribution); shares are of these {{ failed }}.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Table of failure modes">
<table>
<thead><tr><th scope="col">mode</th><th scope="col">meaning</th><th scope="col" class="num">trials</th><th scope="col" class="num">share</th><th scope="col">attributed to</th></tr></thead>
<tbody>
{% for m in modes %}
<tr><th scope="row" class="keep">{{ m.mode }}</th><td>{{ m.meaning }}</td><td class="num">{{ m.count }}</td><td class="num">{{ "%.0f"|format(100 * m.count / m.of) }} %</td><td>{{ m.attribution }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
<div class="scroll" tabindex="0" role="region" aria-label="Table of causes">
<table>
<thead><tr><th scope="col">cause</th><th scope="col" class="num">trials</th><th scope="col">evidence, for example</th></tr></thead>
<tbody>
{% for cause in causes %}
<tr><th scope="row">{{ cause.name }}<br><span class="meaning">{{ cause.meaning }}</span></th><td class="num">{{ cause.count }} of {{ failed }}</td><td>{% for trial_id, text in cause.examples %}{% if not loop.first %}<br>{% endif %}<b>{{ trial_id }}</b> {{ shortened(text) }}{% endfor %}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
{% else %}
<p>No trial failed: every one succeeded on the named region.{% if unsafe %} But {{ unsafe }} of {{ trials }} did not pass safely; the <a href="#trials">table of trials</a> says why.{% endif %}</p>
{% endif %}
{% if anatomy %}
<h3 class="after">Where contact fell</h3>
<div class="scroll" tabindex="0" role="region" aria-label="Table of where contact fell">
<table>
<thead><tr><th scope="col">named region</th><th scope="col" class="num">trials</th><th scope="col" class="num">region touched</th><th scope="col" class="num">only elsewhere</th><th scope="col" class="num">no contact that counts</th><th scope="col" class="num">crashed</th><th scope="col" class="num">success</th></tr></thead>
<tbody>
{% for row in anatomy %}
<tr{% if row.region == pooled %} class="sum"{% endif %}><th scope="row">{{ row.region }}</th><td class="num">{{ row.n }}</td><td class="num">{{ row.target }}</td><td class="num">{{ row.off_target }}</td><td class="num">{{ row.none }}</td><td class="num">{{ row.process_failure }}</td><td class="num">{{ row.success }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
{% endif %}
</section>
"""


@section("failures", order=80, template=TEMPLATE)
def failures(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    return {
        "trials": page.trials,
        "failed": sum(score.failure_mode is not None for score in page.judged),
        "joints": any(score.failure_mode == "joint_beyond_range" for score in page.judged),
        "unsafe": sum(not score.safety_gated for score in page.judged),
        "modes": failure_modes(page.judged),
        "causes": causes(page.judged),
        "anatomy": [] if only_crashes(page.judged) else anatomy(page.judged),
        "pooled": POOLED,
        "shortened": shortened,
    }
