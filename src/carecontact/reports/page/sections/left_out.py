"""Recordings that are not on the page."""

from __future__ import annotations

from typing import Any

from carecontact.reports.page.paths import inside, of_file
from carecontact.reports.page.section import Page, section

TEMPLATE = """\
<section id="left-out" class="caution">
<h2>Files left out</h2>
<dl>
{% for name, reason in skipped %}
<dt>{{ name }}</dt><dd>not scored: {{ reason }}</dd>
{% endfor %}
{% for name, reason in unread %}
<dt>{{ name }}</dt><dd>scored, but not drawn: {{ reason }}</dd>
{% endfor %}
</dl>
</section>
"""


@section("left out", order=120, template=TEMPLATE)
def left_out(page: Page) -> dict[str, Any] | None:
    if not (page.skipped or page.unread):
        return None
    skipped = [(name, inside(page.folder, of_file(name, why))) for name, why in sorted(page.skipped.items())]
    unread = [(trial_id, inside(page.folder, why)) for trial_id, why in sorted(page.unread.items())]
    return {"skipped": skipped, "unread": unread}
