"""The head of the page: one sentence that somebody who reads nothing else may quote, and the scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from carecontact.recording.schema import Recording
from carecontact.reports.compare.baselines import Baselines, Passed
from carecontact.reports.compare.blind_floor import ALL, role_in
from carecontact.reports.frames import Frame, jpeg_data_uri
from carecontact.reports.intervals import enough
from carecontact.reports.over_seeds import Over
from carecontact.reports.page.section import Kept, Page, section
from carecontact.reports.page.title import protocol_of
from carecontact.reports.replay_commands import replay_commands
from carecontact.reports.short_names import short_names
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import RateDifference

REPLAY = "replay"
"""The shipped baseline that repeats recorded actions blindly."""
TEMPLATE = """\
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


@section("head", order=0, template=TEMPLATE, keep=keep_scene)
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
