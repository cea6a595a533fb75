"""How much a result depends on gates that had to be chosen."""

from __future__ import annotations

from typing import Any

from carecontact.reports.page.gate_figures import gamma_svg, gate_panels
from carecontact.reports.page.section import Page, section

TEMPLATE = """\
<section>
<h2>How much depends on the gates</h2>
<p class="note">The gates are choices. Above: runs that stay safety-gated as the share of the pain limit that is allowed grows, with the Wilson 95 % interval; more than the region-correct runs they cannot be. Below: one gate moved at a time, the others as in the protocol, counted over the trials that have to pass it. A dotted line marks the protocol's own value.</p>
{{ gamma_svg|safe }}
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
</section>
"""


@section("gates", order=60, template=TEMPLATE)
def gates(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    return {
        "gamma_svg": gamma_svg(page.judged, gamma=page.gamma),
        "panels": gate_panels(page.judged, page.protocol),
    }
