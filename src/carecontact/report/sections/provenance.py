"""Sections that say what to keep in mind about a run: cautions, caveats, what was left out, provenance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from carecontact.errors import counted
from carecontact.protocol.lock import frozen_state
from carecontact.protocol.sections import Variation
from carecontact.recording.schema import Header, Recording
from carecontact.report.links import MAX_TEXT, inside, of_file
from carecontact.report.run_page import Kept, Page, section
from carecontact.report.sections.funnel import funnel
from carecontact.report.words import SEEDS_FOR_INTERVAL, clipped_text, enough_seeds, listed, percent
from carecontact.runs.pooling import PROVENANCE, machines, mixed, rejected_text
from carecontact.runs.pooling import incomplete as told
from carecontact.scoring.metrics.force import GLIDE_M
from carecontact.scoring.result import TrialScore

# What a reader must know before any number: a run that is incomplete, and a tissue whose calibration was rejected.

CAUTIONS_TEMPLATE = """\
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


@section("incomplete", order=10, template=CAUTIONS_TEMPLATE)
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


# What a run cannot say, each sentence computed from the run.

Caveat = tuple[str, str]
"""Topic and sentence."""
CAVEATS_TEMPLATE = """\
<section id="caveats" class="caution">
<h2>What this run cannot say</h2>
<dl>
{% for topic, text in limits %}
<dt>{{ topic }}</dt><dd>{{ text }}</dd>
{% endfor %}
</dl>
</section>
"""


def _keep_isolation(score: TrialScore, recording: Recording, kept: Kept) -> None:
    if "wall/isolation" in recording.arrays:
        kept[score.trial_id] = recording["wall/isolation"].tobytes().decode(errors="replace")


@section("caveats", order=130, template=CAVEATS_TEMPLATE, keep=_keep_isolation)
def caveats(page: Page) -> dict[str, Any]:
    return {"limits": cannot_say(page)}


def cannot_say(page: Page) -> list[Caveat]:
    headers = list(page.headers.values())
    return [
        *_privileged(page.scores),
        *_few(page),
        *_bodies(headers),
        *_alive(headers),
        *_variation(headers),
        *_protocol(headers),
        *_extrapolation(page.scores),
        *_gone_through(page.scores),
        *_clipped(page.scores),
        *_baselines(page),
        *_incomplete(page),
        *_isolation(page),
        ("Simulation", "These are forces on a simulated person. They say nothing about comfort, pain or injury."),
    ]


def _privileged(scores: Sequence[TrialScore]) -> list[Caveat]:
    if not any(score.privileged for score in scores):
        return []
    text = (
        "The policy was given the simulation: the true skin, pose and contact force. Its rates show what can be done, "
        "as a ceiling; they rank no method."
    )
    return [("Privileged", text)]


def _few(page: Page) -> list[Caveat]:
    steps = funnel(page.scores, unknown=len(page.unjudged))
    if not steps:
        return []
    last = steps[-1]
    passes = f"{last.count.partition(' of ')[0]} safety-gated {'pass' if last.count.startswith('1 of') else 'passes'}"
    if not enough_seeds(page.judged):
        text = (
            f"{passes} of {last.n}, with fewer than "
            f"{SEEDS_FOR_INTERVAL} seeds: too few for an interval, and too few to show any difference between policies."
        )
        return [(f"n = {last.n}", text)]
    text = (
        f"{passes} of {last.n} are compatible with any true rate from {percent(last.low)} "
        f"to {percent(last.high)}; each task has only {_task_counts(page.scores)}. "
        "This run cannot show small differences between policies."
    )
    return [(f"n = {last.n}", text)]


def _bodies(headers: Sequence[Header]) -> list[Caveat]:
    bodies = sorted({h.body for h in headers})
    if not bodies:
        return []
    count = "One body" if len(bodies) == 1 else f"{len(bodies)} bodies"
    text = (
        f"This run simulates only {', '.join(bodies)}; it says nothing about other body shapes, ages and skin colours."
    )
    return [(count, text)]


def _alive(headers: Sequence[Header]) -> list[Caveat]:
    """Return what the person does by itself, whether a command or the protocol's file asked for it."""
    asked = [h.spec.protocol.person.alive for h in headers]
    texts = {
        "breathes": any(alive.breathing for alive in asked),
        "changes its posture": any(alive.repositioning for alive in asked),
        "withdraws the arm from a force": any(alive.withdrawal for alive in asked),
        "helps when the arm is moved": any(alive.manner == "helps" for alive in asked),
        "holds against being moved": any(alive.manner == "holds" for alive in asked),
    }
    does = [text for text, on in texts.items() if on]
    if not does:
        return []
    told = f"The person {', '.join(does)}. Force and joints include what the person does, also before any contact."
    return [("A person who moves", told)]


def _protocol(headers: Sequence[Header]) -> list[Caveat]:
    protocols = {h.spec.protocol.sha256: h.spec.protocol for h in headers}.values()
    found: list[Caveat] = []
    if any(not protocol.frozen for protocol in protocols):
        text = "The protocol is not frozen: it may still change, and results under different releases must not be compared."
        found.append(("Draft protocol", text))
    changed = sorted({state for protocol in protocols if (state := frozen_state(protocol)).startswith("not ")})
    if changed:
        text = f"The protocol is {'; '.join(changed)}. Do not compare these numbers with those of the frozen protocol."
        found.append(("Not the frozen protocol", text))
    return found


def _baselines(page: Page) -> list[Caveat]:
    found: list[Caveat] = []
    if page.judged and page.baselines is None:
        text = (
            f"{page.kept_scores}{' ' if page.kept_scores else ''}"
            f"This page does not show how many trials a policy that cannot do the task passes. Run "
            f"{_blind_but(page.judged[0].policy)} with the same seeds and name them with carecontact report DIR "
            "--baseline RUN..."
        )
        found.append(("No blind baselines", text))
    if page.lost_baselines:
        names = ", ".join(sorted(page.lost_baselines))
        text = f"The last report showed {names} beside this run; this time, the scores could not be read or compared."
        found.append(("Missing blind baselines", text))
    return found


BLIND = ("zero-action", "hover", "random", "replay", "replay-registered", "mean-person")


def _blind_but(policy: str) -> str:
    """Return the shipped blind baselines, without the policy of the run."""
    *first, last = (name for name in BLIND if name != policy)
    return f"{', '.join(first)} and {last}"


def _incomplete(page: Page) -> list[Caveat]:
    found: list[Caveat] = []
    if page.skipped:
        text = f"{counted(len(page.skipped), 'file')} could not be scored: see the end of this page."
        found.append(("Files left out", text))
    if several := mixed(page.judged):
        found.append(("Several machines", several))
    return found


def _isolation(page: Page) -> list[Caveat]:
    """Return trials whose policy ran with less isolation than there is, or was opened more than it needs."""
    reached = {tuple(text.split("; ", 1)) for text in page.kept.get("caveats", {}).values()}
    less = sorted({level for level, *_ in reached if not level.startswith("full")})
    opened = sorted({option for _, *options in reached for option in options})
    said = [f"The policy's process was not fully isolated from the benchmark ({' / '.join(less)})."] if less else []
    said += (
        [f"The user opened more files to the policy than it has by itself ({' / '.join(opened)})."] if opened else []
    )
    return [("Isolation", f"{' '.join(said)} See docs/threat-model.md.")] if said else []


def _variation(headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Return what a seed changes, and so what the trials of a task can differ in."""
    angles = sorted({h.spec.protocol.randomization.comfort_arm_deg for h in headers})
    if not angles:
        return []
    spans = ", ".join(f"{low:g}–{high:g}°" for low, high in angles)
    measured = [h.comfort_arm_deg for h in headers if h.comfort_arm_deg is not None]
    seen = f"; in the recordings read it was {_range(measured)}°" if measured else ""
    angle = f"the angle of the person's arm to the trunk (drawn from {spans}{seen})"
    more = sorted({text for h in headers for text in _varied(h.spec.protocol.variation)})
    if not more:
        text = (
            f"Between seeds only {angle} changes, so that actions repeated blindly may pass: see the blind baselines."
        )
        return [("What seeds change", text)]
    *first, last = [angle, *more]
    return [("What seeds change", f"Seeds differ in {', '.join(first)} and {last}; nothing else is covered.")]


def _varied(variation: Variation) -> list[str]:
    along, across, yaw = 1000 * variation.place_along_m, 1000 * variation.place_across_m, variation.place_yaw_deg
    place = f"up to {along:g} mm along, {across:g} mm across and {yaw:g}° of yaw either way"
    texts = {
        f"the person's place on the bed ({place})": any((along, across, yaw)),
        "appearance": variation.appearance != "baked",
        "light": variation.light != "fixed",
        "depth noise": variation.depth_noise != "none",
        "encoder noise": variation.encoder_noise_rad > 0,
        "the error of the cameras' calibration": variation.calibration_m > 0 or variation.calibration_deg > 0,
        "the stiffness of the soft regions": variation.tissue != "declared",
        "the body": bool(variation.bodies),
        "the turn of shoulder and palm": any((*variation.shoulder_rotation_deg, *variation.palm_deg)),
        "the place of the overhead camera": variation.overhead_shift_m > 0 or variation.overhead_turn_deg > 0,
        "the place of the robot": variation.parking is not None,
    }
    return [text for text, on in texts.items() if on]


def _extrapolation(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    shares = [s.extrapolated_share for s in scores if s.extrapolated_share is not None]
    if not shares:
        return []
    beyond = sum(share > 0 for share in shares)
    if not beyond:
        trials = {1: "the trial", 2: "both trials"}.get(len(shares), f"all {len(shares)} trials")
        text = f"In {trials} with contact on the region, the indentation stayed where the tissue is valid."
    else:
        text = (
            f"In {beyond} of {counted(len(shares), 'trial')} with contact on the region, part of the contact time "
            f"(at most {percent(max(shares))}) was deeper than the tissue is valid: beyond the measured range, where "
            f"forces follow an extrapolated curve, or beyond {1000 * GLIDE_M:g} mm under a moving tool, where they may "
            "jump."
        )
    return [("Extrapolated tissue", text)]


def _gone_through(scores: Sequence[TrialScore]) -> list[Caveat]:
    trials = [s.trial_id for s in scores if s.skin_in_tool is not None]
    if not trials:
        return []
    text = (
        f"In {counted(len(trials), 'trial')}, the skin lay beyond the middle of the robot's tool when the force was largest "
        f"({', '.join(trials)}). The tool had gone through the simulated skin, and its forces say nothing of a person."
    )
    return [("Tool gone through the skin", text)]


def _clipped(scores: Sequence[TrialScore]) -> list[Caveat]:
    text = clipped_text(scores)
    return [("Clipped actions", text)] if text else []


def _task_counts(scores: Sequence[TrialScore]) -> str:
    counts = sorted({sum(s.task_id == task and s.is_judged for s in scores) for task in {s.task_id for s in scores}})
    low, high = counts[0], counts[-1]
    return f"{low} trial{'' if low == 1 else 's'}" if low == high else f"{low} to {high} trials"


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.1f}", f"{max(values):.1f}"
    return low if low == high else f"{low}–{high}"


# Recordings that are not on the page.

LEFT_OUT_TEMPLATE = """\
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


@section("left out", order=120, template=LEFT_OUT_TEMPLATE)
def left_out(page: Page) -> dict[str, Any] | None:
    if not (page.skipped or page.unread):
        return None
    skipped = [(name, inside(page.folder, of_file(name, why))) for name, why in sorted(page.skipped.items())]
    unread = [(trial_id, inside(page.folder, why)) for trial_id, why in sorted(page.unread.items())]
    return {"skipped": skipped, "unread": unread}


# The table of what the numbers come from: versions, hashes and settings.

FIRST_VERSIONS = ("carecontact", "mujoco", "numpy", "mediapipe")
NOT_RECORDED = "not recorded"
PACE = "wall/pace"
PROVENANCE_TEMPLATE = """\
<section id="provenance">
<h2>Where the numbers come from</h2>
<p class="note">From the scores of {{ "the only trial" if n == 1 else "all %d trials"|format(n) }} and the header{{ "" if read == 1 else "s" }} of the {{ read }} recording{{ "" if read == 1 else "s" }} read for this page.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Provenance">
<table>
<tbody>
{% for name, value in provenance %}
<tr><th scope="row">{{ name }}</th><td{% if "sha256" in name %} class="hash"{% endif %}>{{ value }}</td></tr>
{% endfor %}
</tbody>
</table>
</div>
</section>
"""


def _keep_wall(score: TrialScore, recording: Recording, kept: Kept) -> None:
    kept[score.trial_id] = recording[PACE].tolist() if PACE in recording.arrays else None


@section("provenance", order=140, template=PROVENANCE_TEMPLATE, keep=_keep_wall)
def provenance(page: Page) -> dict[str, Any]:
    return {
        "n": len(page.judged),
        "read": len(page.headers),
        "provenance": [
            *provenance_rows(page.judged or page.scores, list(page.headers.values())),
            *((title.capitalize(), _distinct(machines(page.scores, name))) for name, title in PROVENANCE.items()),
            *_pace(list(page.kept.get("provenance", {}).values())),
        ],
    }


def provenance_rows(scores: Sequence[TrialScore], headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Name and value; several values where the trials differ. ``headers``: of the recordings that were read."""
    protocols = [h.spec.protocol for h in headers]
    rows = [
        ("Protocol", _distinct(s.protocol_title for s in scores)),
        ("Protocol sha256", _distinct(s.protocol_sha256 for s in scores)),
        ("Protocol state", _distinct(frozen_state(p) for p in protocols)),
        ("Policy", _distinct(s.policy_title for s in scores)),
        *_salt(scores),
        *_given(headers),
        ("Language backend", _distinct(s.language_backend for s in scores)),
        *_language(scores),
        ("Embodiment", _distinct(h.embodiment for h in headers)),
        ("Body", _distinct(h.body for h in headers)),
        ("Tissue set", _distinct(p.person.tissue_set for p in protocols)),
    ]
    regions = sorted({(region, t.source) for p in protocols for region, t in p.person.tissue.items()})
    rows += [(f"Tissue, {region.replace('_', ' ')}", source) for region, source in regions]
    rows.append(("Force limits", _distinct(f"{p.limits.pack}, γ′ = {p.limits.gamma:g}" for p in protocols)))
    metrics = sorted({version for s in scores for version in s.metric_versions.values()})
    metrics += sorted({id_ for s in scores for id_ in s.additional})
    rows.append(("Metrics", ", ".join(metrics) or NOT_RECORDED))
    names = {name for h in headers for name in h.versions}
    rows += [
        (f"Version of {name}", _distinct(h.versions[name] for h in headers if name in h.versions))
        for name in (*FIRST_VERSIONS, *sorted(names - set(FIRST_VERSIONS)))
    ]
    assets = sorted({name for h in headers for name in h.sha256})
    rows += [(f"sha256 of {name}", _distinct(h.sha256[name] for h in headers if name in h.sha256)) for name in assets]
    warnings = sum(bool(h.solver_warnings) for h in headers)
    rows.append(
        ("Solver warnings", f"in {warnings} of {counted(len(headers), 'recording')} read" if warnings else "none")
    )
    return rows


def _given(headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Arguments and variables, only where a policy was given any; a remote policy's card alone names them."""
    cards = [
        h.card or {"arguments": h.spec.policy_arguments, "environment": h.spec.policy_environment} for h in headers
    ]
    arguments = [" ".join(f"{name}={text}" for name, text in card.get("arguments", {}).items()) for card in cards]
    variables = [" ".join(card.get("environment", ())) for card in cards]
    rows = (("Policy arguments", arguments), ("Policy variables", variables))
    return [(name, _distinct(value or "none" for value in values)) for name, values in rows if any(values)]


def _salt(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    """Only where a trial was salted: the sha256 to which the run committed."""
    hashes = [s.world.get("salt", "none") for s in scores]
    return [("Salt sha256", _distinct(hashes))] if set(hashes) - {"none"} else []


def _language(scores: Sequence[TrialScore]) -> list[tuple[str, str]]:
    """Only where an endpoint was asked."""
    rows = (
        ("Language endpoint", [s.language_endpoint for s in scores]),
        ("Language model served", [s.language_served for s in scores]),
        ("Sampling accepted", [s.language_sent for s in scores]),
    )
    return [(name, _distinct(v for v in values if v)) for name, values in rows if any(values)]


def _pace(kept: Sequence[list[float] | None]) -> list[tuple[str, str]]:
    """Only where a trial had one: the pace [s] and how many of its observations came late."""
    if not any(kept):
        return []
    late = sum(bool(pace and pace[1]) for pace in kept)
    text = _distinct(f"{pace[0]:g} s for each control period" if pace else "none" for pace in kept)
    return [("Pace", f"{text}; observations came late in {late} of {counted(len(kept), 'recording')} read")]


def _distinct(values: Iterable[str]) -> str:
    """Return the values in order; beyond three, how many they are."""
    found = sorted(set(values))
    if len(found) > 3:
        return f"{len(found)} different values, the first {found[0]}"
    return ", ".join(found) or NOT_RECORDED
