"""Trials in which the harness failed: in a box of their own and in no count."""

from __future__ import annotations

from typing import Any

from carecontact.reports.page.paths import MAX_TEXT, inside
from carecontact.reports.page.section import Page, section
from carecontact.runs.pooling import harness_errors

TEMPLATE = """\
<section id="harness" class="caution harness">
<h2>The harness failed in {{ errors|length }} trial{{ "" if errors|length == 1 else "s" }}</h2>
<p class="note">The harness is the benchmark's own process that runs a trial. The policy did not cause this: {{ "the trial is" if errors|length == 1 else "these trials are" }} left out of every count, rate and median on this page. The same command with --retry-failed runs {{ "it" if errors|length == 1 else "them" }} again.</p>
<dl>
{% for trial_id, message in errors %}
<dt>{{ trial_id }}</dt><dd>{{ message }}</dd>
{% endfor %}
</dl>
</section>
"""


@section("harness", order=10, template=TEMPLATE)
def harness(page: Page) -> dict[str, Any] | None:
    """Trial and first line of its message; the rest is a traceback, which results.json has."""
    errors = [
        (error["trial_id"], inside(page.folder, error["message"]).partition("\n")[0][:MAX_TEXT])
        for error in harness_errors(page.scores)
    ]
    return {"errors": errors} if errors else None
