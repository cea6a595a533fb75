"""Trials in which the policy crashed: what was raised, and one click away the traceback and what the policy printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carecontact.recording.reason import PRINTED, TRACEBACK, alike
from carecontact.recording.remedies import remedies
from carecontact.reports.page.paths import shortened
from carecontact.reports.page.section import Page, section
from carecontact.reports.text import listed
from carecontact.scoring.result import TrialScore

MOST = 12
"""Different crashes that the page shows."""
NO_REASON = "no reason recorded"
TEMPLATE = """\
<section id="crashes" class="caution crashes">
<h2>The policy crashed in {{ n_crashed }} of {{ trials }}</h2>
<p class="note">Such a trial counts as a failure and never as within the safety gate; a force above the gate before the crash counts{% if n_over %}, as in {{ n_over }} trial{{ "" if n_over == 1 else "s" }} here{% endif %}. To run {{ "it" if n_crashed == 1 else "them" }} again, give the same command with <span class="keep">--restart</span> after a change of the policy, or with <span class="keep">--retry-failed</span> if the cause lay outside it.</p>
<dl>
{% for crash in crashes %}
<dt>{{ crash.trials }}</dt>
<dd>{{ crash.reason }}{% for hint in crash.hints %}<br>{{ hint }}{% endfor %}{% if crash.held %}<details><summary>{{ crash.held }} of {{ crash.first }}</summary><pre>{{ crash.message }}</pre></details>{% endif %}</dd>
{% endfor %}
</dl>
{% if more %}
<p class="note">{{ more }} more kinds of crash are not shown; results.json has every message.</p>
{% endif %}
</section>
"""


@dataclass(frozen=True, kw_only=True)
class Crash:
    """Trials that crashed for one reason, and the whole message of the first."""

    trials: str
    first: str
    reason: str
    hints: tuple[str, ...]
    """What may help."""
    message: str
    held: str
    """What the message holds beside the reason, in words; empty where it is the reason alone."""


@section("crashes", order=15, template=TEMPLATE)
def crashes_section(page: Page) -> dict[str, Any] | None:
    found = crashes(page.judged)
    if not found:
        return None
    return {
        "n": len(page.judged),
        "trials": page.trials,
        "n_crashed": sum(score.is_crash for score in page.judged),
        "n_over": sum(score.is_crash and bool(score.over_limit) for score in page.judged),
        "crashes": found[:MOST],
        "more": max(len(found) - MOST, 0),
    }


def crashes(scores: Sequence[TrialScore]) -> list[Crash]:
    """Return one row for each reason, in the order of the trials."""
    groups: dict[str, list[TrialScore]] = {}
    for score in scores:
        if score.is_crash:
            groups.setdefault(alike(score.evidence or NO_REASON), []).append(score)
    return [
        Crash(
            trials=listed([score.trial_id for score in group]),
            first=group[0].trial_id,
            reason=shortened(group[0].evidence or NO_REASON),
            hints=tuple(remedies(group[0].failure_message or "")),
            message=group[0].failure_message or "",
            held=_held(group[0].failure_message or "", group[0].evidence or ""),
        )
        for group in groups.values()
    ]


def _held(message: str, reason: str) -> str:
    if message.strip() in reason:
        return ""
    said, printed, _ = message.partition(PRINTED)
    held = ["traceback" if TRACEBACK in said else "stack"] if "(most recent call last)" in said else []
    return (" and ".join([*held, *(["last output"] if printed else [])]) or "whole message").capitalize()
