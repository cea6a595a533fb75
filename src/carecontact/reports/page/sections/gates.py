"""How much a result depends on gates that had to be chosen."""

from __future__ import annotations

from typing import Any

from carecontact.reports.failures import only_crashes
from carecontact.reports.intervals import enough_seeds
from carecontact.reports.page.gate_figures import gamma_flat, gamma_svg, gate_panels
from carecontact.reports.page.section import Page, section

TEMPLATE = """\
<section id="gates">
<h2>How much depends on the gates</h2>
<p class="note">The values of the gates are choices of the benchmark. {% if gamma_svg %}The curve is the share of safety-gated trials over the allowed share γ′ of the pain limit{% if enough %}, with its Wilson 95 % interval{% endif %}; the share of region-correct trials is its upper bound. {% endif %}{% if panels %}Each small figure shows the trials that pass with another value of one gate, and the other gates as in the protocol, over the trials to which this gate applies. {% endif %}{% if gamma_svg or panels %}A dotted line marks the protocol's own value.{% else %}None of them decides a result of this run.{% endif %}{% if trials %} All counts are of the {{ trials }}.{% endif %}</p>
{% if flat %}
<dl class="flat">
{% for title, text in flat %}
<dt>{{ title }}</dt><dd>{{ text }}</dd>
{% endfor %}
</dl>
{% endif %}
{{ gamma_svg|safe }}
{% if panels %}
<ul class="legend">
{% for name in ("success", "region-correct", "safety-gated") %}
<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="level{{ loop.index0 }}" d="M0 6h26"/><circle class="dot{{ loop.index0 }}" cx="13" cy="6" r="{{ (5, 4, 2.4)[loop.index0] }}"/></svg>{{ name }}</li>
{% endfor %}
</ul>
<div class="panels">
{% for panel in panels %}
<figure><h3>{{ panel.title }} <span>{{ panel.n }} trial{{ "" if panel.n == 1 else "s" }}</span></h3>
{{ panel.svg|safe }}</figure>
{% endfor %}
</div>
{% endif %}
</section>
"""


@section("gates", order=60, template=TEMPLATE)
def gates(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    panels, level = gate_panels(page.judged, page.protocol), gamma_flat(page.judged)
    flat = [("γ′, allowed share of the pain limit", level)] if level else []
    return {
        "trials": page.trials if page.unjudged else "",
        "enough": enough_seeds(page.judged),
        "gamma_svg": "" if level else gamma_svg(page.judged, gamma=page.gamma),
        "flat": [*flat, *((panel.title, panel.flat) for panel in panels if panel.flat)],
        "panels": [panel for panel in panels if not panel.flat],
    }
