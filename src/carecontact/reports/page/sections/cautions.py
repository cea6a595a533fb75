"""What a reader must know before any number: a run that is incomplete, and a tissue whose calibration was rejected."""

from __future__ import annotations

from typing import Any

from carecontact.reports.page.paths import MAX_TEXT, inside
from carecontact.reports.page.section import Page, section
from carecontact.reports.text import listed
from carecontact.runs.pooling import incomplete as told
from carecontact.runs.pooling import rejected_text

TEMPLATE = """\
<section id="incomplete" class="caution harness">
<h2>The run is {{ told }}</h2>
<p class="note">The policy did not cause this. Therefore, each count on this page goes from all other trials failed to all of them passed, medians are over the trials with a verdict, and the run is not compared or ranked. The same carecontact run command again runs what is missing; the parts of a run that was split go together with carecontact merge.</p>
<dl>
{% for trials, message in reasons %}
<dt>{{ trials }}</dt><dd>{{ message }}</dd>
{% endfor %}
</dl>
</section>
"""


@section("incomplete", order=10, template=TEMPLATE)
def incomplete(page: Page) -> dict[str, Any] | None:
    """Trials and the first line of the reason; the rest is a traceback, which results.json has."""
    reasons: dict[str, list[str]] = {}
    for trial, why in page.unjudged.items():
        reasons.setdefault(inside(page.folder, why).partition("\n")[0][:MAX_TEXT], []).append(trial)
    if not reasons:
        return None
    return {
        "told": told(len(page.judged), page.unjudged),
        "reasons": [(listed(trials), why) for why, trials in reasons.items()],
    }


REJECTED = """\
<section id="rejected" class="caution">
<h2>The calibration of the tissue was rejected</h2>
<p class="note">{{ text }}</p>
</section>
"""


@section("rejected tissue", order=5, template=REJECTED)
def rejected_tissue(page: Page) -> dict[str, Any] | None:
    text = rejected_text(page.scores)
    return {"text": text} if text else None
